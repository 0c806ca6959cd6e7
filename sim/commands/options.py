"""Commands about the body in the water: simulated, calibrated, validated."""

from __future__ import annotations

import argparse
from pathlib import Path

from sim2real.commands.command import Command, add_former, add_recordings


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
    command.add_argument("--plot", type=Path, metavar="PNG", help="the water at the end")
    add_former(command, "--picture", "plot")
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


def _diagnose(command: argparse.ArgumentParser) -> None:
    add_recordings(command)
    command.add_argument("--robot", type=Path, required=True, help="robot.toml")
    command.add_argument("--model", type=Path, help="MODEL.json to start from")
    command.add_argument(
        "--references",
        type=Path,
        nargs="+",
        metavar="RECORDING",
        help="recordings from before: name only what has changed since",
    )
    command.add_argument(
        "--out", type=Path, required=True, metavar="DIAGNOSIS", help="diagnosis.json"
    )
    command.add_argument(
        "--in-water",
        type=Path,
        metavar="NPZ",
        help="swims: the fluid swims what was sent (a minute of a GPU; kept in NPZ, or read from "
        "it), and the twin says only what changes",
    )
    command.add_argument("--device", default="cpu", help="cpu (default) or cuda:0, for the fluid")
    command.add_argument(
        "--negligible",
        type=float,
        default=0.05,
        metavar="SHARE",
        help="what changes the held-out error by less is listed, no verdict (default 0.05)",
    )
    command.add_argument("--no-page", action="store_true", help="write no DIAGNOSIS.html")


COMMANDS = (
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
