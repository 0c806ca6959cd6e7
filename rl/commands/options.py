"""Command-line options for training, evaluating and deploying policies."""

from __future__ import annotations

import argparse
from pathlib import Path

from rl import verbs
from sim2real.commands.command import (
    Command,
    add_executor,
    add_file,
    add_flag,
    add_number,
    add_verb,
)

_TASKS = ("point", "near", "mixed", "chain", "turn", "pentagram")
_ARMS = (
    "all", "no-servo", "no-density", "no-randomization", "all-and-effects", "ceiling", "none",
    "midway",
)  # fmt: skip


def _water(command: argparse.ArgumentParser) -> None:
    add_file(command, "--robot", "ROBOT", "the robot (robot.toml)", required=True)
    add_file(command, "--model", "MODEL", "its servos and body (MODEL.json)", required=True)
    add_file(
        command,
        "--ranges",
        "RANGES",
        "randomization ranges that episodes are drawn from (ranges.json)",
    )
    command.add_argument(
        "--fidelity",
        choices=("twin", "fluid"),
        default="twin",
        help="simulate in the reduced-order twin (default) or in the fluid",
    )
    command.add_argument(
        "--device", default="cpu", help="device of the simulation, cpu (default) or cuda:0"
    )
    add_number(command, "--cell-m", "M", "side of a cell of the fluid, m", 0.02)
    add_number(command, "--threads", "THREADS", "CPU threads of the simulator", 1)


def _sampled(command: argparse.ArgumentParser) -> None:
    add_flag(
        command,
        "--sampled",
        "sample actions from the policy, as in training, instead of taking their mean",
    )


def _executor(command: argparse.ArgumentParser) -> None:
    add_executor(command, otherwise="all runs in one batch")


def _plan(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--recipe",
        choices=("default", "paper", "brief", "fine"),
        help="settings of training: default (a decision every 80 ms), paper (the "
        "task of the paper), or brief and fine, which continue from trained policies",
    )
    command.add_argument(
        "--steps", type=int, help="simulation steps of 20 ms per agent (default 1600000)"
    )
    command.add_argument("--envs", type=int, help="parallel environments per agent (default 64)")
    command.add_argument("--segment", type=int, help="steps between checkpoints (default 200000)")
    command.add_argument(
        "--updates-per-step", type=float, help="gradient updates per environment step (default 0.1)"
    )
    command.add_argument(
        "--learning-rate", type=float, help="initial learning rate (default 0.001)"
    )
    command.add_argument(
        "--discount", type=float, help="discount factor per decision (default 0.99)"
    )
    command.add_argument(
        "--energy-weight",
        type=float,
        help="weight of the squared joint rates in the reward (default 0.0007)",
    )
    command.add_argument(
        "--energy-start",
        type=float,
        metavar="SHARE",
        help="share of that weight at the start, raised once the agents swim (default 0.1)",
    )


def _train(command: argparse.ArgumentParser) -> None:
    _water(command)
    add_file(command, "--out", "FOLDER", "folder of the run", required=True)
    command.add_argument(
        "--controller",
        choices=("sac", "discrete-cpg"),
        default="sac",
        help="what the policy chooses: joint angles (sac, default) or the gait of a pattern "
        "generator",
    )
    command.add_argument("--task", choices=_TASKS, help="task to train on (default chain)")
    add_flag(command, "--quick", "a small run in the twin: minutes on a CPU")
    add_number(command, "--seeds", "N", "number of agents, one per random seed", 1)
    _plan(command)
    command.add_argument(
        "--first",
        nargs="+",
        type=Path,
        metavar="POLICY",
        help="policies that training continues from, one per seed; with --recipe fine, from "
        "the twin to the fluid",
    )
    command.add_argument(
        "--trials",
        type=int,
        default=20,
        metavar="N",
        help="held-out episodes that select each agent's price of energy, and the best "
        "agent (default 20; 0 for none)",
    )
    add_flag(command, "--tensorboard", "also write TensorBoard event files")
    add_flag(command, "--no-plots", "do not plot the learning curve (curve.png)")
    _executor(command)


def _ablate(command: argparse.ArgumentParser) -> None:
    _water(command)
    add_file(
        command,
        "--reality",
        "REALITY",
        "the reality that policies are tested in and never trained in: MODEL.json, or a"
        " Python file with a function make",
        required=True,
    )
    add_file(
        command,
        "--enriched",
        "ENRICHED",
        "model with diagnosed effects (MODEL.json), for the arm all-and-effects",
    )
    add_file(
        command,
        "--truth",
        "MODEL",
        "true parameters (MODEL.json), for the arm ceiling (default: --reality, if that"
        " is a model)",
    )
    add_file(command, "--out", "FOLDER", "folder of the run", required=True)
    command.add_argument("--arms", nargs="+", choices=_ARMS, help="arms to compare (default: all)")
    add_number(command, "--seeds", "N", "random seeds, each one agent, of each arm", 6)
    add_number(command, "--repeats", "REPEATS", "episodes that each agent is tested on", 10)
    command.add_argument(
        "--reality-cell-m",
        type=float,
        metavar="M",
        help="cell of the fluid in the reality, m (default: half of that in training, or as "
        "the Python file states)",
    )
    add_flag(command, "--forecast", "also forecast each arm's reward")
    _sampled(command)
    command.add_argument("--task", choices=_TASKS, help="task to train on (default chain)")
    add_flag(command, "--quick", "a small run in the twin: minutes on a CPU")
    command.add_argument(
        "--first",
        nargs="+",
        type=Path,
        metavar="POLICY",
        help="policies that training continues from, one per seed in turn, such as those of "
        "the arm midway",
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
    command.add_argument("--task", choices=_TASKS, default="turn", help="task (default turn)")
    _sampled(command)
    add_number(command, "--episodes", "EPISODES", "number of episodes", 50)
    command.add_argument(
        "--energy-weight", type=float, help="weight of the energy in the reward (default 0.0007)"
    )
    add_file(
        command,
        "--gains",
        "TOML",
        "gains of the controllers pnl and adrc (default: tuned in the twin)",
    )
    add_file(command, "--out", "JSON", "file to write the results to")
    add_file(command, "--plot", "PNG", "plot of the trajectories to write")
    add_file(
        command,
        "--video",
        "MP4",
        "video of the first episode of each policy to write (.mp4, .avi or .gif)",
    )


def _forecast(command: argparse.ArgumentParser) -> None:
    add_verb(command, verbs.forecast, positional=("policies",), leave_out=("kept",))
    add_file(command, "--out", "JSON", "forecast to write (forecast.json)", required=True)
    add_flag(command, "--no-page", "do not write the HTML page")


def _export(command: argparse.ArgumentParser) -> None:
    add_file(command, "policy", "POLICY", "trained policy (POLICY.zip)")
    add_file(command, "--out", "FILE", "file to write (policy.npz)", required=True)
    command.add_argument(
        "--format",
        nargs="+",
        choices=("npz", "c", "onnx"),
        help="NumPy arrays (.npz), a C header (.h) or ONNX (.onnx); by default as FILE ends",
    )
    command.add_argument(
        "--price",
        type=float,
        help="price of energy relative to training: 0.5 swims faster, 2 saves energy "
        "(default: as in the file)",
    )


def _swim(command: argparse.ArgumentParser) -> None:
    add_file(command, "policy", "POLICY", "policy (policy.npz or policy.zip)")
    command.add_argument(
        "--target",
        required=True,
        metavar="X,Y",
        help="target in the frame of the pool, m; write negative values as --target=-1,0.5",
    )
    command.add_argument(
        "--port",
        metavar="URL",
        help="radio of the robot: udp://HOST:PORT; with --bus the port of its servos",
    )
    command.add_argument(
        "--bus",
        metavar="NAME",
        help="drive servos on a bus of this computer: lx, dynamixel or feetech",
    )
    command.add_argument("--baud", type=int, metavar="N", help="bits per second, with --bus")
    command.add_argument("--ids", metavar="LIST", help="ids of the servos, with --bus: 1,2,3")
    command.add_argument(
        "--reverse",
        nargs="+",
        metavar="JOINT",
        help="joints whose servo turns in the opposite direction, with --bus",
    )
    command.add_argument(
        "--pose",
        metavar="URL",
        help="address of this computer to which a tracker sends poses, with --bus: udp://HOST:PORT "
        "(udp://:PORT for a tracker on this computer, udp://0.0.0.0:PORT for any)",
    )
    command.add_argument(
        "--key-file",
        type=Path,
        metavar="FILE",
        help="file with a key that robot and tracker share, of at least 16 characters, which "
        "authenticates their datagrams (default: environment variable SIM2REAL_KEY; none without)",
    )
    add_number(
        command,
        "--max-temperature",
        "C",
        "stop when a servo is hotter, with --bus, degrees Celsius",
        65.0,
    )
    add_flag(command, "--virtual", "drive a virtual robot, simulated in the twin")
    add_file(command, "--robot", "ROBOT", "the robot, with --virtual or --bus (robot.toml)")
    add_file(command, "--model", "MODEL", "servos and body of the virtual robot (MODEL.json)")
    add_number(command, "--seconds", "SECONDS", "longest time to swim, s", 20.0)
    add_file(command, "--out", "CSV", "recording of the swim to write")


def _demo(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--data",
        type=Path,
        default=Path("datasets/servo_steps"),
        metavar="FOLDER",
        help="recordings of the servos (default datasets/servo_steps)",
    )
    command.add_argument(
        "--pool",
        type=Path,
        default=Path("datasets/pool"),
        metavar="FOLDER",
        help="recordings of the pool (default datasets/pool)",
    )
    command.add_argument(
        "--out",
        type=Path,
        default=Path("reports/demo"),
        metavar="FOLDER",
        help="folder for the report (default reports/demo)",
    )
    add_flag(
        command,
        "--train",
        "train the ablation's agents in this run, minutes on two cores (default: evaluate "
        "those shipped with the data)",
    )


COMMANDS = (
    Command("demo", "rl.commands.demo", _demo, "sim2real demo --out reports/demo"),
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
        "forecast",
        "rl.commands.forecast",
        _forecast,
        "sim2real forecast policy.zip --robot fish.toml --model model.json --ranges ranges.json "
        "--limit 'time_s<=6@0.95' --out forecast.json",
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
