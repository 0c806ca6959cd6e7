"""Commands that need the fluid or its twin for bodies in the water."""

from __future__ import annotations

import argparse

from sim import verbs
from sim2real.commands.command import Command, add_file, add_flag, add_former, add_views
from sim2real.commands.verb import add_verb


def _simulate(command: argparse.ArgumentParser) -> None:
    add_file(command, "model", "MODEL", "servos and body (MODEL.json)")
    add_file(
        command, "recordings", "COMMANDS", "recording or table of commands (t_s, J.command_rad)"
    )
    add_verb(command, verbs.simulate, leave_out=("recordings", "model"))
    add_file(command, "--out", "CSV", "recording to write", required=True)
    add_views(command)
    add_former(command, "--picture", "plot")


def _calibrate(command: argparse.ArgumentParser) -> None:
    add_verb(command, verbs.calibrate)
    add_file(command, "--out", "MODEL", "model to write (MODEL.json)", required=True)
    add_flag(command, "--no-plots", "do not plot the fit (MODEL.RECORDING.png)")


def _diagnose(command: argparse.ArgumentParser) -> None:
    add_verb(command, verbs.diagnose)
    add_file(command, "--out", "DIAGNOSIS", "diagnosis to write (diagnosis.json)", required=True)
    add_flag(command, "--no-page", "do not write the HTML report")
    add_views(command)


def _design(command: argparse.ArgumentParser) -> None:
    add_verb(command, verbs.design)
    add_file(command, "--out", "CSV", "commands to write (next.csv)", required=True)
    add_flag(command, "--no-page", "do not write the HTML page")


COMMANDS = (
    Command(
        "design",
        "sim.commands.design",
        _design,
        "sim2real design --robot robot.toml --model model.json --out next.csv",
    ),
    Command(
        "diagnose",
        "sim.commands.diagnose",
        _diagnose,
        "sim2real diagnose steps.csv chirp.csv --robot robot.toml --out diagnosis.json",
    ),
    Command(
        "simulate",
        "sim.commands.simulate",
        _simulate,
        "sim2real simulate model.json wave.csv --robot fish.toml --out swim.csv",
    ),
    Command(
        "calibrate",
        "sim.commands.calibrate",
        _calibrate,
        "sim2real calibrate swim.csv --robot fish.toml --model model.json --out calibrated.json",
    ),
)
