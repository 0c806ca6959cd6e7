"""Commands that talk to servos, and to those who play them."""

from __future__ import annotations

import argparse
from pathlib import Path

from sim2real.commands.command import Command, add_file, add_flag, add_number

_PORT = "port: /dev/ttyUSB0, socket://HOST:PORT or udp://HOST:PORT"


def _add_bus(command: argparse.ArgumentParser, *, port_required: bool = False) -> None:
    """The bus, its port and its rate."""
    command.add_argument("--port", required=port_required, metavar="URL", help=_PORT)
    _add_protocol(command)


def _add_protocol(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--bus",
        default="lx",
        metavar="NAME",
        help="protocol of the servos: lx, dynamixel (2.0) or feetech (default lx)",
    )
    command.add_argument(
        "--baud",
        type=int,
        metavar="N",
        help="bits per second (default 115200 for lx, 1000000 for the others)",
    )


def _record(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "signal",
        metavar="SIGNAL",
        help="steps, sine, square, chirp, multisine, or a file of commands (COMMANDS.csv)",
    )
    add_file(
        command,
        "--robot",
        "ROBOT",
        "the robot, for the limits of its joints (robot.toml)",
        required=True,
    )
    _add_bus(command)
    command.add_argument(
        "--ids", metavar="LIST", help="id of the servo of each joint, such as 1,2,3"
    )
    add_file(command, "--out", "CSV", "recording to write")
    command.add_argument(
        "--joints", nargs="+", metavar="JOINT", help="joints to move (default: all)"
    )
    command.add_argument(
        "--trim",
        metavar="LIST",
        help="offset of each servo in ticks, such as 4,0,-2: position at angle 0 minus that at the "
        "centre of the servo",
    )
    command.add_argument(
        "--reverse",
        nargs="+",
        metavar="JOINT",
        help="joints whose servo turns in the opposite direction",
    )
    command.add_argument(
        "--inertia", metavar="LIST", help="inertia of the load on each joint, kg m2"
    )
    command.add_argument(
        "--medium",
        choices=("air", "water"),
        default="air",
        help="what the robot moves in (default air)",
    )
    command.add_argument("--source", metavar="TEXT", help="source of the recording, stored with it")
    add_number(command, "--seconds", "SECONDS", "duration, s", 30.0)
    command.add_argument(
        "--amplitude",
        type=float,
        metavar="RAD",
        help="amplitude, rad (default: 3/4 of what the limits allow)",
    )
    add_number(command, "--frequency", "HZ", "frequency of sine and square, Hz", 1.0)
    command.add_argument(
        "--band",
        type=float,
        nargs=2,
        default=(0.1, 2.0),
        metavar="HZ",
        help="lowest and highest frequency of chirp and multisine, Hz (default 0.1 2)",
    )
    add_number(
        command, "--max-temperature", "C", "stop when a servo is hotter, degrees Celsius", 65.0
    )
    add_flag(command, "--overwrite", "replace an existing recording")
    add_flag(command, "--dry-run", "show the signal and move nothing")
    add_file(command, "--plot", "PNG", "plot of the signal to write")


def _bench(command: argparse.ArgumentParser) -> None:
    _add_bus(command, port_required=True)
    command.add_argument(
        "--ids", required=True, metavar="LIST", help="ids of the servos, such as 1 or 1,2,3"
    )
    command.add_argument(
        "--out",
        type=Path,
        default=Path("bench"),
        metavar="FOLDER",
        help="folder for recording, robot, model and page (default bench)",
    )
    command.add_argument(
        "--mass", metavar="LIST", help="mass of the load on each servo, kg (asked for by default)"
    )
    command.add_argument(
        "--arm", metavar="LIST", help="distance of that mass from each shaft, m (with --mass)"
    )
    command.add_argument(
        "--inertia",
        metavar="LIST",
        help="inertia of the load on each servo, kg m2, instead of --mass and --arm",
    )
    add_flag(command, "--unknown-load", "identify per unit of inertia, ask nothing")
    command.add_argument(
        "--shaft",
        choices=("horizontal", "vertical"),
        default="horizontal",
        help="horizontal (default): the mass hangs straight down at the centre of the servo; "
        "vertical: no gravity",
    )
    add_number(command, "--reach", "RAD", "largest deviation from the centre, rad", 0.6)
    add_file(
        command,
        "--robot",
        "ROBOT",
        "limits and data sheet, one joint per servo (robot.toml); by default those of the "
        "servo's model are written to the folder",
    )
    add_number(command, "--seconds", "SECONDS", "duration, s", 30.0)
    add_number(
        command, "--max-temperature", "C", "stop when a servo is hotter, degrees Celsius", 65.0
    )
    add_flag(command, "--overwrite", "replace an existing folder")


def _scan(command: argparse.ArgumentParser) -> None:
    _add_bus(command, port_required=True)
    command.add_argument(
        "--ids",
        default="0-253",
        metavar="LIST",
        help="ids to ask, such as 1,2,10-20 (default: all)",
    )


def _virtual_servo(command: argparse.ArgumentParser) -> None:
    _add_protocol(command)
    command.add_argument(
        "--servo", metavar="NAME", help="model of the servos (default XL330-M288 or STS3215)"
    )
    command.add_argument(
        "--ids", default="1", metavar="LIST", help="ids of the servos, such as 1,2,3 (default 1)"
    )
    command.add_argument(
        "--udp",
        metavar="HOST:PORT",
        help="listen there for UDP packets (default: open a pseudo-terminal)",
    )
    add_file(command, "--model", "MODEL", "servos to simulate, in order (MODEL.json)")
    add_number(command, "--kp", "NM_PER_RAD", "proportional gain without --model, N m/rad", 2.2)
    add_number(command, "--kd", "NMS_PER_RAD", "damping without --model, N m s/rad", 0.06)
    add_number(command, "--latency", "S", "latency without --model, s", 0.06)
    add_number(command, "--inertia", "KGM2", "inertia of the load without --model, kg m2", 0.002)
    add_number(command, "--supply", "V", "reported supply voltage, V", 7.4)
    add_number(
        command, "--temperature", "C", "reported temperature at the start, degrees Celsius", 30.0
    )
    add_number(
        command, "--heating", "C_PER_S", "rate at which it rises, degrees Celsius per second", 0.0
    )
    command.add_argument(
        "--loss", type=float, default=0.0, help="share of packets lost in each direction"
    )
    command.add_argument("--noise", type=float, default=0.0, help="share of corrupted bytes")
    add_flag(command, "--echo", "echo what the host sends, as on a half-duplex wire")
    add_flag(command, "--fast", "transmit without the delay of the baud rate")


def _track(command: argparse.ArgumentParser) -> None:
    add_file(command, "video", "VIDEO", "overhead video of the pool")
    add_file(command, "--camera", "CAMERA", "camera (camera.toml)", required=True)
    add_file(command, "--out", "CSV", "pool recording to write", required=True)
    add_file(command, "--servo", "CSV", "recording of the servos to combine with the poses")
    command.add_argument(
        "--joints",
        nargs="+",
        default=["j1"],
        metavar="JOINT",
        help="names of the joints, without --servo",
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
        "pictures",
        nargs="+",
        type=Path,
        metavar="PICTURE",
        help="pictures of a ChArUco board, or a video of one",
    )
    command.add_argument(
        "--board",
        default="7,5,0.04,0.03",
        metavar="LIST",
        help="ChArUco board: squares across, squares down, side of a square in m, side of a "
        "marker in m",
    )
    command.add_argument(
        "--dictionary",
        choices=_DICTIONARIES,
        default="4x4_50",
        help="ArUco dictionary of the board (default 4x4_50)",
    )
    command.add_argument(
        "--pool", default="3.6,3.6", metavar="LIST", help="length and width of the pool in m"
    )
    command.add_argument(
        "--corners",
        nargs=4,
        metavar="U,V",
        required=True,
        help="pixels of the four corners of the pool: the origin first, then along x",
    )
    add_file(command, "--out", "TOML", "camera (camera.toml)", required=True)


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
        "bench",
        "sim2real.commands.bench",
        _bench,
        "sim2real bench --bus feetech --port /dev/ttyUSB0 --ids 1 --mass 0.1 --arm 0.12",
    ),
    Command("scan", "sim2real.commands.scan", _scan, "sim2real scan --port /dev/ttyUSB0"),
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
