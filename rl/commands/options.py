"""Commands about policies: trained, tried, taken to the robot."""

from __future__ import annotations

import argparse
from pathlib import Path

from sim2real.commands.command import Command

_TASKS = ("point", "near", "mixed", "chain", "turn", "pentagram")
_ARMS = (
    "all",
    "no-servo",
    "no-density",
    "no-randomization",
    "all-and-effects",
    "ceiling",
    "none",
    "midway",
)


def _water(command: argparse.ArgumentParser) -> None:
    command.add_argument("--robot", type=Path, required=True, help="robot.toml")
    command.add_argument("--model", type=Path, required=True, help="MODEL.json")
    command.add_argument("--ranges", type=Path, help="ranges.json to draw episodes from")
    command.add_argument("--fidelity", choices=("twin", "fluid"), default="twin")
    command.add_argument("--device", default="cpu", help="cpu (default) or cuda:0")
    command.add_argument("--cell-m", type=float, default=0.02, metavar="M", help="of the fluid")
    command.add_argument("--threads", type=int, default=1, help="of the simulator (default 1)")


def _sampled(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--sampled",
        action="store_true",
        help="policies act as in training, with their own noise, and not by their mean",
    )


def _executor(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--executor",
        choices=("local", "ray"),
        help="a process for each run, here or on a Ray cluster (default: all runs in one batch)",
    )
    command.add_argument(
        "--jobs", type=int, metavar="N", help="runs at a time (default: one a GPU)"
    )
    command.add_argument("--address", help="the Ray cluster, HOST:PORT (default: this machine's)")
    command.add_argument(
        "--retries", type=int, default=2, help="more attempts for a run that died (default 2)"
    )


def _plan(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--recipe",
        choices=("default", "paper", "brief", "fine"),
        help="a decision every 80 ms and what goes with it (default), the paper's own task, or "
        "what goes on from policies that swim, elsewhere or nearly here",
    )
    command.add_argument("--steps", type=int, help="of 20 ms, of each agent (default 800000)")
    command.add_argument("--envs", type=int, help="environments of each agent (default 64)")
    command.add_argument("--segment", type=int, help="steps between checkpoints (default 200000)")
    command.add_argument("--updates-per-step", type=float, help="(default 0.1)")
    command.add_argument("--learning-rate", type=float, help="at first (default 0.001)")
    command.add_argument("--discount", type=float, help="of a decision later (default 0.99)")
    command.add_argument(
        "--energy-weight", type=float, help="of the joints' squared rates (default 0.0007)"
    )
    command.add_argument(
        "--energy-start",
        type=float,
        metavar="SHARE",
        help="of that weight until robots swim; then it grows (default 0.1)",
    )


def _train(command: argparse.ArgumentParser) -> None:
    _water(command)
    command.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="the run's")
    command.add_argument(
        "--controller",
        choices=("sac", "discrete-cpg"),
        default="sac",
        help="what learns: joint angles (default), or which gait of a pattern generator",
    )
    command.add_argument("--task", choices=_TASKS, help="(default chain)")
    command.add_argument("--quick", action="store_true", help="minutes on a CPU, in the twin")
    command.add_argument("--seeds", type=int, default=1, metavar="N", help="agents (default 1)")
    _plan(command)
    command.add_argument(
        "--first",
        nargs="+",
        type=Path,
        metavar="POLICY",
        help="policies to go on from, one a seed; with --recipe fine from the twin to the fluid",
    )
    command.add_argument(
        "--trials",
        type=int,
        default=20,
        metavar="N",
        help="held-out turns and targets that choose each agent's price of energy, and among the "
        "agents (default 20; 0 for none)",
    )
    command.add_argument("--tensorboard", action="store_true", help="write its files too")
    command.add_argument("--no-plots", action="store_true", help="write no curve.png")
    _executor(command)


def _ablate(command: argparse.ArgumentParser) -> None:
    _water(command)
    command.add_argument(
        "--reality",
        type=Path,
        required=True,
        help="what training never sees: MODEL.json, or a Python file that offers make",
    )
    command.add_argument("--enriched", type=Path, help="MODEL.json with what diagnose found")
    command.add_argument(
        "--truth",
        type=Path,
        metavar="MODEL",
        help="reality's own parameters, for the arm ceiling (default: --reality, where it is one)",
    )
    command.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="the run's")
    command.add_argument("--arms", nargs="+", choices=_ARMS, help="(default: all)")
    command.add_argument(
        "--seeds", type=int, default=6, metavar="N", help="of each arm (default 6)"
    )
    command.add_argument("--repeats", type=int, default=10, help="turns of each agent (default 10)")
    command.add_argument(
        "--reality-cell-m",
        type=float,
        metavar="M",
        help="of its water (default: half of training's, or the Python file's own)",
    )
    _sampled(command)
    command.add_argument("--task", choices=_TASKS, help="to train at (default chain)")
    command.add_argument("--quick", action="store_true", help="minutes on a CPU, in the twin")
    command.add_argument(
        "--first",
        nargs="+",
        type=Path,
        metavar="POLICY",
        help="policies that each arm's seeds go on from in turn, such as those of the arm midway",
    )
    _plan(command)
    _executor(command)


def _evaluate(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "policies",
        nargs="+",
        metavar="POLICY",
        help="policy.zip, policy.zip@0.5 at another price of energy, policy.npz, pnl or adrc, "
        "also pnl-fast, pnl-frugal and so on",
    )
    _water(command)
    command.add_argument("--task", choices=_TASKS, default="turn", help="(default turn)")
    _sampled(command)
    command.add_argument("--episodes", type=int, default=50, help="robots (default 50)")
    command.add_argument("--energy-weight", type=float, help="in the reward (default 0.0007)")
    command.add_argument(
        "--gains",
        type=Path,
        metavar="TOML",
        help="of pnl and adrc (default: those tuned in the twin)",
    )
    command.add_argument("--out", type=Path, metavar="JSON", help="figures to write")
    command.add_argument("--plot", type=Path, metavar="PNG", help="trajectories to draw")
    command.add_argument(
        "--video", type=Path, metavar="MP4", help="each policy's first robot, or a .avi, .gif of it"
    )


def _export(command: argparse.ArgumentParser) -> None:
    command.add_argument("policy", type=Path, metavar="POLICY", help="POLICY.zip, a trained SAC")
    command.add_argument("--out", type=Path, required=True, metavar="FILE", help="policy.npz")
    command.add_argument(
        "--format",
        nargs="+",
        choices=("npz", "c", "onnx"),
        help="NumPy arrays, a C header, ONNX: FILE with .npz, .h, .onnx (default: FILE's ending)",
    )
    command.add_argument(
        "--price",
        type=float,
        help="of energy, over the training's: 0.5 is faster, 2 more frugal (default: the file's)",
    )


def _swim(command: argparse.ArgumentParser) -> None:
    command.add_argument("policy", type=Path, metavar="POLICY", help="policy.npz, or a SAC's .zip")
    command.add_argument(
        "--target", required=True, metavar="X,Y", help="in the pool's frame in m; --target=-1,0.5"
    )
    command.add_argument("--port", metavar="URL", help="the robot's radio: udp://HOST:PORT")
    command.add_argument("--virtual", action="store_true", help="a virtual robot, in the twin")
    command.add_argument("--robot", type=Path, help="robot.toml of the virtual robot")
    command.add_argument("--model", type=Path, help="MODEL.json of the virtual robot")
    command.add_argument("--seconds", type=float, default=20.0, help="at most (default 20)")
    command.add_argument("--out", type=Path, metavar="CSV", help="recording of the swim to write")


def _demo(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--data", type=Path, default=Path("datasets/servo_steps"), metavar="FOLDER"
    )
    command.add_argument("--pool", type=Path, default=Path("datasets/pool"), metavar="FOLDER")
    command.add_argument("--out", type=Path, default=Path("reports/demo"), metavar="FOLDER")
    command.add_argument(
        "--train",
        action="store_true",
        help="train the ablation's agents in this run, minutes on two cores (default: evaluate "
        "those shipped with the data)",
    )


COMMANDS = (
    Command(
        "demo",
        "rl.commands.demo",
        _demo,
        "sim2real demo --out reports/demo",
    ),
    Command(
        "train",
        "rl.commands.train",
        _train,
        "sim2real train --quick --robot fish.toml --model model.json --out runs/quick",
        resumes=True,
    ),
    Command(
        "evaluate",
        "rl.commands.evaluate",
        _evaluate,
        "sim2real evaluate policy.zip pnl --task turn --robot fish.toml --model model.json",
    ),
    Command(
        "ablate",
        "rl.commands.ablate",
        _ablate,
        "sim2real ablate --robot fish.toml --model model.json --ranges ranges.json "
        "--reality reality.py --out runs/ablation",
        resumes=True,
    ),
    Command(
        "export",
        "rl.commands.export",
        _export,
        "sim2real export policy.zip --out policy.npz --format npz c",
    ),
    Command(
        "swim",
        "rl.commands.swim",
        _swim,
        "sim2real swim policy.npz --target 1.2,-0.4 --port udp://192.168.4.1:4210 --out swim.csv",
    ),
)
