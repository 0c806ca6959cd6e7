"""Commands that need the fluid or its twin for bodies in the water."""

from __future__ import annotations

import argparse
from pathlib import Path

from sim import verbs
from sim2real.commands.command import Command, add_former, add_views
from sim2real.commands.verb import add_verb


def _simulate(command: argparse.ArgumentParser) -> None:
    command.add_argument("model", type=Path, metavar="MODEL", help="servos and body (MODEL.json)")
    command.add_argument(
        "recordings",
        type=Path,
        metavar="COMMANDS",
        help="recording or table of commands (t_s, J.command_rad)",
    )
    add_verb(command, verbs.simulate, leave_out=("recordings", "model"))
    command.add_argument(
        "--out", type=Path, required=True, metavar="CSV", help="recording to write"
    )
    add_views(command)
    add_former(command, "--picture", "plot")


def _calibrate(command: argparse.ArgumentParser) -> None:
    add_verb(command, verbs.calibrate)
    command.add_argument(
        "--out", type=Path, required=True, metavar="MODEL", help="model to write (MODEL.json)"
    )
    command.add_argument(
        "--no-plots", action="store_true", help="do not plot the fit (MODEL.RECORDING.png)"
    )


def _validate(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--device", default="cpu", help="device of the simulation, cpu (default) or cuda:0"
    )
    command.add_argument(
        "--quick",
        action="store_true",
        help="coarse versions with wider tolerances, in seconds",
    )
    command.add_argument(
        "--only", nargs="+", default=(), metavar="CASE", help="cases to run (default: all)"
    )
    command.add_argument(
        "--out",
        type=Path,
        default=Path("reports/validation.html"),
        metavar="PAGE",
        help="report to write (default reports/validation.html)",
    )


def _diagnose(command: argparse.ArgumentParser) -> None:
    add_verb(command, verbs.diagnose)
    command.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="DIAGNOSIS",
        help="diagnosis to write (diagnosis.json)",
    )
    command.add_argument("--no-page", action="store_true", help="do not write the HTML report")
    add_views(command)


def _design(command: argparse.ArgumentParser) -> None:
    add_verb(command, verbs.design)
    command.add_argument(
        "--out", type=Path, required=True, metavar="CSV", help="commands to write (next.csv)"
    )
    command.add_argument("--no-page", action="store_true", help="do not write the HTML page")


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
    Command(
        "validate",
        "sim.commands.validate",
        _validate,
        "sim2real validate --only cavity --out reports/validation.html",
    ),
)
