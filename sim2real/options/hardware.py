"""Commands that talk to servos, and to those who play them."""

from __future__ import annotations

import argparse
from pathlib import Path

from sim2real.options.command import Command


def _record(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "signal", metavar="SIGNAL", help="steps, sine, square, chirp, multisine, or COMMANDS.csv"
    )
    command.add_argument("--robot", type=Path, required=True, help="robot.toml, for the limits")
    command.add_argument("--port", metavar="URL", help="/dev/ttyUSB0, socket://, udp://HOST:PORT")
    command.add_argument("--ids", metavar="LIST", help="servo in each joint, as 1,2,3")
    command.add_argument("--out", type=Path, metavar="CSV", help="recording to write")
    command.add_argument("--joints", nargs="+", metavar="JOINT", help="only these (default: all)")
    command.add_argument("--trim", metavar="LIST", help="ticks at angle 0 less 500, as 4,0,-2")
    command.add_argument(
        "--reverse", nargs="+", metavar="JOINT", help="joints whose servo turns the other way"
    )
    command.add_argument("--inertia", metavar="LIST", help="load of each joint in kg m2")
    command.add_argument("--medium", choices=("air", "water"), default="air")
    command.add_argument("--source", metavar="TEXT", help="where the recording comes from")
    command.add_argument("--seconds", type=float, default=30.0, help="length (default 30)")
    command.add_argument(
        "--amplitude", type=float, metavar="RAD", help="(default: 3/4 of what the limits allow)"
    )
    command.add_argument(
        "--frequency", type=float, default=1.0, metavar="HZ", help="of sine and square (default 1)"
    )
    command.add_argument(
        "--band",
        type=float,
        nargs=2,
        default=(0.1, 2.0),
        metavar="HZ",
        help="of chirp and multisine (default 0.1 2)",
    )
    command.add_argument(
        "--max-temperature", type=float, default=65.0, metavar="C", help="stop above (default 65)"
    )
    command.add_argument("--overwrite", action="store_true", help="replace a recording")
    command.add_argument("--dry-run", action="store_true", help="show the signal, drive nothing")
    command.add_argument("--plot", type=Path, metavar="PNG", help="draw the signal")


def _scan(command: argparse.ArgumentParser) -> None:
    command.add_argument("--port", required=True, metavar="URL", help="as for record")
    command.add_argument(
        "--ids", default="0-253", metavar="LIST", help="whom to ask, as 1,2,10-20 (default: all)"
    )


def _virtual_servo(command: argparse.ArgumentParser) -> None:
    command.add_argument("--ids", default="1", metavar="LIST", help="as 1,2,3 (default 1)")
    command.add_argument(
        "--udp", metavar="HOST:PORT", help="be a radio there (default: a pseudo-terminal)"
    )
    command.add_argument("--model", type=Path, help="MODEL.json: its joints in order")
    command.add_argument("--kp", type=float, default=2.2, metavar="NM_PER_RAD")
    command.add_argument("--kd", type=float, default=0.06, metavar="NMS_PER_RAD")
    command.add_argument("--latency", type=float, default=0.06, metavar="S")
    command.add_argument("--inertia", type=float, default=0.002, metavar="KGM2")
    command.add_argument("--supply", type=float, default=7.4, metavar="V")
    command.add_argument("--temperature", type=float, default=30.0, metavar="C")
    command.add_argument("--heating", type=float, default=0.0, metavar="C_PER_S")
    command.add_argument("--loss", type=float, default=0.0, help="share of packets lost, each way")
    command.add_argument("--noise", type=float, default=0.0, help="share of bytes spoilt")
    command.add_argument("--echo", action="store_true", help="the host hears itself, on one wire")
    command.add_argument("--fast", action="store_true", help="bytes take no time on the wire")


COMMANDS = (
    Command(
        "record",
        "sim2real.commands.record",
        _record,
        "play a signal on real servos and record what they do",
        "sim2real record steps --robot robot.toml --port /dev/ttyUSB0 --ids 1,2,3 --out steps.csv",
    ),
    Command(
        "scan",
        "sim2real.commands.scan",
        _scan,
        "list the servos on a bus: position, supply, temperature, errors",
        "sim2real scan --port /dev/ttyUSB0",
    ),
    Command(
        "virtual-servo",
        "sim2real.commands.virtual_servo",
        _virtual_servo,
        "be servos on a bus, for those who have none",
        "sim2real virtual-servo --ids 1,2,3 --loss 0.02 --noise 0.001",
    ),
)
"""In the order in which help lists them."""
