"""Commands that need the fluid or its twin for bodies in the water."""

from __future__ import annotations

import argparse

from sim import verbs
from sim2real.commands.command import VIEWS, Command, add_former, add_options, add_verb, command

_SWIMS = "sim.commands.swims"
_NO_PAGE = "--no-page: do not write the HTML page"
_CALIBRATE = """
--out MODEL!: model to write (MODEL.json)
--no-plots: do not plot the fit (MODEL.RECORDING.png)
"""
_SIMULATE = """
model MODEL: servos and body (MODEL.json)
recordings CSV: recording or table of commands (t_s, J.command_rad)
--out CSV!: recording to write
"""


def _simulate(parser: argparse.ArgumentParser) -> None:
    add_options(parser, _SIMULATE)
    add_options(parser, VIEWS)
    add_verb(parser, verbs.simulate, leave_out=("recordings", "model"))
    add_former(parser, "--picture", "plot")


COMMANDS = (
    command(
        "design",
        f"{_SWIMS}:design",
        [verbs.design, "--out CSV!: commands to write (next.csv)", _NO_PAGE],
        "sim2real design --robot robot.toml --model model.json --out next.csv",
    ),
    command(
        "diagnose",
        "sim.commands.diagnose",
        [verbs.diagnose, "--out FILE!: diagnosis to write (diagnosis.json)", _NO_PAGE, VIEWS],
        "sim2real diagnose steps.csv chirp.csv --robot robot.toml --out diagnosis.json",
    ),
    Command(
        "simulate",
        f"{_SWIMS}:simulate",
        _simulate,
        "sim2real simulate model.json wave.csv --robot fish.toml --out swim.csv",
    ),
    command(
        "calibrate",
        f"{_SWIMS}:calibrate",
        [verbs.calibrate, _CALIBRATE],
        "sim2real calibrate swim.csv --robot fish.toml --model model.json --out calibrated.json",
    ),
)
