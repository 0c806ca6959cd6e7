"""Commands about the body in the water: simulated, calibrated, validated."""

from __future__ import annotations

import argparse
from pathlib import Path

from sim2real.options.command import Command


def _simulate(command: argparse.ArgumentParser) -> None:
    command.add_argument("model", type=Path, metavar="MODEL", help="MODEL.json")
    command.add_argument("commands", type=Path, metavar="COMMANDS", help="CSV: t_s, J.command_rad")
    command.add_argument("--robot", type=Path, required=True, help="robot.toml")
    command.add_argument(
        "--out", type=Path, required=True, metavar="CSV", help="recording to write"
    )
    command.add_argument("--device", default="cpu", help="cpu (default) or cuda:0")
    command.add_argument("--cell-m", type=float, default=0.02, metavar="M", help="side of a cell")
    command.add_argument("--dimensions", type=int, choices=(2, 3), default=3)
    command.add_argument("--walls", action="store_true", help="a closed box, not one that follows")
    command.add_argument("--picture", type=Path, metavar="PNG", help="the water at the end")
    command.add_argument("--video", type=Path, metavar="MP4", help="the swim; or .avi, .gif")


def _calibrate(command: argparse.ArgumentParser) -> None:
    command.add_argument("recordings", nargs="+", type=Path, metavar="POOL", help="NAME.csv")
    command.add_argument("--robot", type=Path, required=True, help="robot.toml")
    command.add_argument("--model", type=Path, required=True, help="MODEL.json of the servos")
    command.add_argument("--out", type=Path, required=True, metavar="MODEL", help="MODEL.json")
    command.add_argument("--fit-gains", action="store_true", help="not only the servos' latency")
    command.add_argument("--fluid", action="store_true", help="go on in the fluid (a GPU's work)")
    command.add_argument("--device", default="cpu", help="cpu (default) or cuda:0, for the fluid")
    command.add_argument("--cell-m", type=float, default=0.02, metavar="M", help="side of a cell")
    command.add_argument(
        "--rollouts", type=int, default=48, metavar="N", help="of a batch in the fluid (default 48)"
    )
    command.add_argument(
        "--held-out", type=float, default=1 / 3, help="share of each swim to score on (default 1/3)"
    )
    command.add_argument("--no-plots", action="store_true", help="write no MODEL.RECORDING.png")


def _validate(command: argparse.ArgumentParser) -> None:
    command.add_argument("--device", default="cpu", help="cpu (default) or cuda:0")
    command.add_argument("--quick", action="store_true", help="seconds, with looser bars")
    command.add_argument("--only", nargs="+", default=(), metavar="CASE")
    command.add_argument("--out", type=Path, default=Path("reports/validation.html"))


COMMANDS = (
    Command(
        "simulate",
        "sim.commands.simulate",
        _simulate,
        "swim a recording's commands in the lattice-Boltzmann pool",
        "sim2real simulate model.json wave.csv --robot fish.toml --out swim.csv",
    ),
    Command(
        "calibrate",
        "sim.commands.calibrate",
        _calibrate,
        "fit the body in the water to swims in a pool",
        "sim2real calibrate swim.csv --robot fish.toml --model model.json --out calibrated.json",
    ),
    Command(
        "validate",
        "sim.commands.validate",
        _validate,
        "run the published cases that the fluid is measured against",
        "sim2real validate --only cavity --out reports/validation.html",
    ),
)
"""In the order in which help lists them."""
