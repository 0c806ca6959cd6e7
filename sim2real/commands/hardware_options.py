"""Commands that talk to servos, and to those who play them."""

from __future__ import annotations

import argparse
from pathlib import Path

from sim2real.commands.command import Command


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


def _track(command: argparse.ArgumentParser) -> None:
    command.add_argument("video", type=Path, metavar="VIDEO", help="from above the pool")
    command.add_argument("--camera", type=Path, required=True, help="camera.toml")
    command.add_argument("--out", type=Path, required=True, metavar="CSV", help="pool recording")
    command.add_argument(
        "--servo", type=Path, metavar="CSV", help="recording of the servos to join"
    )
    command.add_argument(
        "--joints", nargs="+", default=["j1"], metavar="JOINT", help="names, where none is joined"
    )
    command.add_argument(
        "--sync",
        default="correlate",
        metavar="HOW",
        help="correlate (yaw with joints, default), flash (a lamp lit at the recording's start), "
        "or the video's time in s at the recording's 0",
    )


def _calibrate_camera(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "pictures", nargs="+", type=Path, metavar="PICTURE", help="of a ChArUco board, or a video"
    )
    command.add_argument(
        "--board", default="7,5,0.04,0.03", metavar="LIST", help="across,down,square,marker in m"
    )
    command.add_argument("--dictionary", choices=_DICTIONARIES, default="4x4_50")
    command.add_argument("--pool", default="3.6,3.6", metavar="LIST", help="length,width in m")
    command.add_argument(
        "--corners", nargs=4, metavar="U,V", help="pixels of the pool's corners: 0,0 first, then x"
    )
    command.add_argument(
        "--corner-ids", metavar="LIST", help="markers on those corners, as 10,11,12,13"
    )
    command.add_argument("--pool-picture", type=Path, metavar="PICTURE", help="where they are seen")
    command.add_argument("--out", type=Path, required=True, metavar="TOML", help="camera.toml")


_DICTIONARIES = (
    "4x4_50", "4x4_100", "5x5_50", "5x5_100", "6x6_50", "6x6_250",
    "apriltag_16h5", "apriltag_25h9", "apriltag_36h11",
)  # fmt: skip


COMMANDS = (
    Command(
        "record",
        "sim2real.commands.record",
        _record,
        "sim2real record steps --robot robot.toml --port /dev/ttyUSB0 --ids 1,2,3 --out steps.csv",
    ),
    Command(
        "scan",
        "sim2real.commands.scan",
        _scan,
        "sim2real scan --port /dev/ttyUSB0",
    ),
    Command(
        "virtual-servo",
        "sim2real.commands.virtual_servo",
        _virtual_servo,
        "sim2real virtual-servo --ids 1,2,3 --loss 0.02 --noise 0.001",
    ),
    Command(
        "track",
        "sim2real.commands.track",
        _track,
        "sim2real track swim.mp4 --camera camera.toml --servo servos.csv --out swim.csv",
    ),
    Command(
        "calibrate-camera",
        "sim2real.commands.calibrate_camera",
        _calibrate_camera,
        "sim2real calibrate-camera board.mp4 --corners 98,429 516,441 529,22 110,8 "
        "--out camera.toml",
    ),
)
