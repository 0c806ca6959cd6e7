"""The command line: which commands there are and what they take.

Each command lives in a file of its own that is imported only when it runs, so that help is instant.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from sim2real.errors import InputError

_COMMON = argparse.ArgumentParser(add_help=False)
_COMMON.add_argument("--seed", type=int, default=0, help="seed of everything random (default 0)")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Returns:
        0 if it is done, 2 if its input is at fault (said in one line), 1 for anything else.
    """
    options = _parser().parse_args(arguments)
    try:
        status: int = importlib.import_module(options.module).run(options)
        sys.stdout.flush()
        return status
    except InputError as error:
        print(f"sim2real {options.command}: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"sim2real {options.command}: interrupted; nothing written", file=sys.stderr)
        return 1
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="sim2real",
        description="Make a robot's simulator tell the truth.",
        epilog="'sim2real COMMAND --help' shows what a command takes, with an example.",
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, module, add, help_, example in _COMMANDS:
        command = commands.add_parser(
            name,
            parents=[_COMMON],
            help=help_,
            description=help_[0].upper() + help_[1:] + ".",
            epilog=f"example:\n  {example}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        command.set_defaults(module=module)
        add(command)
    return parser


def _recordings(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "recordings",
        nargs="+",
        type=Path,
        metavar="RECORDING",
        help="NAME.csv, NAME.json beside it",
    )


def _check(command: argparse.ArgumentParser) -> None:
    _recordings(command)
    command.add_argument("--robot", type=Path, help="robot.toml, to check limits and names too")


def _identify(command: argparse.ArgumentParser) -> None:
    _recordings(command)
    command.add_argument("--robot", type=Path, required=True, help="robot.toml")
    command.add_argument("--out", type=Path, required=True, metavar="MODEL", help="MODEL.json")
    command.add_argument(
        "--held-out",
        metavar="NAME",
        help="recording to score on, not fit (default: the last; of a lone one its last quarter)",
    )
    command.add_argument(
        "--effects",
        nargs="+",
        default=(),
        metavar="EFFECT",
        help="effects to fit with the gains, as load_friction or unmodelled_inertia",
    )
    command.add_argument("--no-plots", action="store_true", help="write no MODEL.JOINT.png")


def _predict(command: argparse.ArgumentParser) -> None:
    command.add_argument("model", type=Path, metavar="MODEL", help="MODEL.json")
    command.add_argument("commands", type=Path, metavar="COMMANDS", help="CSV: t_s, J.command_rad")
    command.add_argument("--out", type=Path, required=True, metavar="CSV", help="predicted.csv")


def _diagnose(command: argparse.ArgumentParser) -> None:
    _recordings(command)
    command.add_argument("--robot", type=Path, required=True, help="robot.toml")
    command.add_argument("--model", type=Path, help="MODEL.json to start from")
    command.add_argument(
        "--out", type=Path, required=True, metavar="DIAGNOSIS", help="diagnosis.json"
    )
    command.add_argument("--no-page", action="store_true", help="write no DIAGNOSIS.html")


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
    command.add_argument("--video", type=Path, metavar="MP4", help="the swim, or a .gif of it")


def _calibrate(command: argparse.ArgumentParser) -> None:
    command.add_argument("recordings", nargs="+", type=Path, metavar="POOL", help="NAME.csv")
    command.add_argument("--robot", type=Path, required=True, help="robot.toml")
    command.add_argument("--model", type=Path, required=True, help="MODEL.json of the servos")
    command.add_argument("--out", type=Path, required=True, metavar="MODEL", help="MODEL.json")
    command.add_argument("--fit-gains", action="store_true", help="not only the servos' latency")
    command.add_argument("--fluid", action="store_true", help="go on in the fluid (a GPU's work)")
    command.add_argument("--device", default="cpu", help="cpu (default) or cuda:0, for the fluid")
    command.add_argument("--cell-m", type=float, default=0.02, metavar="M", help="side of a cell")
    command.add_argument("--steps", type=int, default=5, help="most steps of a round in the fluid")
    command.add_argument(
        "--held-out", type=float, default=1 / 3, help="share of each swim to score on (default 1/3)"
    )
    command.add_argument("--no-plots", action="store_true", help="write no MODEL.RECORDING.png")


def _validate(command: argparse.ArgumentParser) -> None:
    command.add_argument("--device", default="cpu", help="cpu (default) or cuda:0")
    command.add_argument("--quick", action="store_true", help="seconds, with looser bars")
    command.add_argument("--only", nargs="+", default=(), metavar="CASE")
    command.add_argument("--out", type=Path, default=Path("reports/validation.html"))


def _density(command: argparse.ArgumentParser) -> None:
    command.add_argument("robot", type=Path, metavar="ROBOT", help="robot.toml")
    command.add_argument("--model", type=Path, help="MODEL.json to put the densities into")
    command.add_argument("--out", type=Path, metavar="MODEL", help="the model with them")
    command.add_argument("--png", type=Path, metavar="PNG", help="how the mass is spread")


def _ranges(command: argparse.ArgumentParser) -> None:
    _recordings(command)
    command.add_argument("--robot", type=Path, required=True, help="robot.toml")
    command.add_argument("--model", type=Path, required=True, help="MODEL.json")
    command.add_argument("--out", type=Path, required=True, metavar="RANGES", help="ranges.json")
    command.add_argument("--steps", type=int, default=2000, help="of each chain (default 2000)")
    command.add_argument("--walkers", type=int, default=32, help="of each chain (default 32)")
    command.add_argument(
        "--held-out", metavar="NAME", help="recording to check on, not sample (default: the last)"
    )
    command.add_argument("--no-page", action="store_true", help="write no RANGES.html")


def _import(command: argparse.ArgumentParser) -> None:
    command.add_argument("source", type=Path, help="a log (.json), or a ROS 1 or 2 bag")
    command.add_argument(
        "--out", type=Path, required=True, metavar="CSV", help="recording to write"
    )
    command.add_argument("--state-topic", metavar="TOPIC", help="bag: measured joint states")
    command.add_argument(
        "--command-topic",
        metavar="TOPIC",
        action="append",
        help="bag: set-points; once, or once for each joint",
    )
    command.add_argument("--joints", nargs="+", metavar="JOINT", help="bag: joints, in order")


def _demo(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--data", type=Path, default=Path("datasets/servo_steps"), metavar="FOLDER"
    )
    command.add_argument("--out", type=Path, default=Path("reports/demo"), metavar="FOLDER")


_COMMANDS: tuple[tuple[str, str, Callable[[argparse.ArgumentParser], None], str, str], ...] = (
    (
        "check",
        "sim2real.commands.check",
        _check,
        "say what recordings are like, and what they can identify, before anyone fits",
        "sim2real check steps.csv sine.csv --robot robot.toml",
    ),
    (
        "identify",
        "sim2real.commands.identify",
        _identify,
        "identify the gains and latency of each servo from recorded steps",
        "sim2real identify steps.csv sine.csv square.csv --robot robot.toml --out model.json",
    ),
    (
        "density",
        "sim2real.commands.density",
        _density,
        "say how a robot's mass is spread along it, link by link",
        "sim2real density robot.toml --model model.json --out weighed.json",
    ),
    (
        "ranges",
        "sim2real.commands.ranges",
        _ranges,
        "make randomization ranges, each from data, and a posterior sample",
        "sim2real ranges steps.csv square.csv --robot robot.toml --model model.json "
        "--out ranges.json",
    ),
    (
        "predict",
        "sim2real.commands.predict",
        _predict,
        "simulate a model from rest on the commands of a CSV",
        "sim2real predict model.json chirp.csv --out predicted.csv",
    ),
    (
        "diagnose",
        "sim.commands.diagnose",
        _diagnose,
        "say which physics the fitted servos leave out, model it and show the fit improve",
        "sim2real diagnose steps.csv chirp.csv --robot robot.toml --out diagnosis.json",
    ),
    (
        "simulate",
        "sim.commands.simulate",
        _simulate,
        "swim a recording's commands in the lattice-Boltzmann pool",
        "sim2real simulate model.json wave.csv --robot fish.toml --out swim.csv",
    ),
    (
        "calibrate",
        "sim.commands.calibrate",
        _calibrate,
        "fit the body in the water to swims in a pool",
        "sim2real calibrate swim.csv --robot fish.toml --model model.json --out calibrated.json",
    ),
    (
        "validate",
        "sim.commands.validate",
        _validate,
        "run the published cases that the fluid is measured against",
        "sim2real validate --only cavity --out reports/validation.html",
    ),
    (
        "import",
        "sim2real.commands.import_logs",
        _import,
        "turn logs of other projects into recordings",
        "sim2real import run.bag --state-topic /joint_states --command-topic /goal --out run.csv",
    ),
    (
        "demo",
        "sim2real.commands.demo",
        _demo,
        "run the whole chain on the shipped data and write an HTML report",
        "sim2real demo --out reports/demo",
    ),
)


if __name__ == "__main__":
    sys.exit(main())
