"""Command-line options for training, evaluating and deploying policies."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from rl import verbs
from sim2real.commands.command import Command, add_executor, add_file, add_flag, add_verb

_TASKS = ("point", "near", "mixed", "chain", "turn", "pentagram")
_ARMS = (
    "all", "no-servo", "no-density", "no-randomization", "all-and-effects", "ceiling", "none",
    "midway",
)  # fmt: skip
_POLICIES = (
    "policy.zip, policy.zip@0.5 at another price of energy, policy.npz, pnl or adrc, "
    "also pnl-fast, pnl-frugal and so on"
)
_REALITY = (
    "the reality that policies are tested in and never trained in: MODEL.json, or a Python file "
    "with a function make"
)
_TRIALS = "held-out episodes that select each agent's price of energy, and the best agent; 0: none"
_KEY = (
    "file with a key that robot and tracker share, of at least 16 characters, which authenticates "
    "their datagrams (default: environment variable SIM2REAL_KEY; none without)"
)
_POSE = (
    "address of this computer to which a tracker sends poses, with --bus: udp://HOST:PORT "
    "(udp://:PORT for a tracker on this computer, udp://0.0.0.0:PORT for any)"
)

_OPTIONS: dict[str, dict[str, tuple[Any, ...]]] = {
    "water": {
        "robot": (Path, "the robot (robot.toml)", "required"),
        "model": (Path, "its servos and body (MODEL.json)", "required"),
        "ranges": (Path, "randomization ranges that episodes are drawn from (ranges.json)"),
        "fidelity": (("twin", "fluid"), "simulate in the reduced-order twin or the fluid", "twin"),
        "device": (str, "device of the simulation, cpu or cuda:0", "cpu"),
        "cell-m": (float, "side of a cell of the fluid, m", 0.02),
        "threads": (int, "CPU threads of the simulator", 1),
    },
    "plan": {
        "task": (_TASKS, "task to train on (default chain)"),
        "quick": (bool, "a small run in the twin: minutes on a CPU"),
        "recipe": (
            ("default", "paper", "brief", "fine"),
            "settings of training: default (a decision every 80 ms), paper (the task of the "
            "paper), or brief and fine, which continue from trained policies",
        ),
        "first": ([Path], "policies that training continues from, one per seed in turn"),
        "steps": (int, "simulation steps of 20 ms per agent (default 1600000)"),
        "envs": (int, "parallel environments per agent (default 64)"),
        "segment": (int, "steps between checkpoints (default 200000)"),
        "updates-per-step": (float, "gradient updates per environment step (default 0.1)"),
        "learning-rate": (float, "initial learning rate (default 0.001)"),
        "discount": (float, "discount factor per decision (default 0.99)"),
        "energy-weight": (float, "weight of squared joint rates in the reward (default 0.0007)"),
        "energy-start": (
            float,
            "share of that weight at the start, raised once the agents swim (default 0.1)",
        ),
    },
    "train": {
        "out": (Path, "folder of the run", "required"),
        "controller": (
            ("sac", "discrete-cpg"),
            "the policy chooses joint angles (sac) or the gait of a pattern generator",
            "sac",
        ),
        "seeds": (int, "number of agents, one per random seed", 1),
        "trials": (int, _TRIALS, 20),
        "no-plots": (bool, "do not plot the learning curve (curve.png)"),
    },
    "ablate": {
        "reality": (Path, _REALITY, "required"),
        "enriched": (
            Path,
            "model with diagnosed effects (MODEL.json), for the arm all-and-effects",
        ),
        "truth": (
            Path,
            "true parameters (MODEL.json), for the arm ceiling (default: --reality, if a model)",
        ),
        "out": (Path, "folder of the run", "required"),
        "arms": ([_ARMS], "arms to compare (default: all)"),
        "seeds": (int, "random seeds, each one agent, of each arm", 6),
        "repeats": (int, "episodes that each agent is tested on", 10),
        "reality-cell-m": (
            float,
            "cell of the fluid in the reality, m (default: half of that in training, or as the "
            "Python file states)",
        ),
        "forecast": (bool, "also forecast each arm's reward"),
    },
    "evaluate": {
        "task": (_TASKS, "task", "turn"),
        "episodes": (int, "number of episodes", 50),
        "energy-weight": (float, "weight of the energy in the reward (default 0.0007)"),
        "gains": (Path, "gains of the controllers pnl and adrc (default: tuned in the twin)"),
        "out": (Path, "file to write the results to (.json)"),
        "plot": (Path, "plot of the trajectories to write (.png)"),
        "video": (Path, "video of each policy's first episode to write (.mp4, .avi or .gif)"),
    },
    "export": {
        "out": (Path, "file to write (policy.npz)", "required"),
        "format": (
            [("npz", "c", "onnx")],
            "NumPy arrays (.npz), a C header (.h) or ONNX (.onnx); by default as FILE ends",
        ),
        "price": (
            float,
            "price of energy relative to training: 0.5 swims faster, 2 saves energy (default: as "
            "in the file)",
        ),
    },
    "swim": {
        "target": (
            str,
            "target X,Y in the frame of the pool, m; write negative values as --target=-1,0.5",
            "required",
        ),
        "port": (str, "radio of the robot: udp://HOST:PORT; with --bus the port of its servos"),
        "bus": (str, "drive servos on a bus of this computer: lx, dynamixel or feetech"),
        "baud": (int, "bits per second, with --bus"),
        "ids": (str, "ids of the servos, with --bus: 1,2,3"),
        "reverse": ([str], "joints whose servo turns in the opposite direction, with --bus"),
        "pose": (str, _POSE),
        "key-file": (Path, _KEY),
        "max-temperature": (
            float,
            "stop when a servo is hotter, with --bus, degrees Celsius",
            65.0,
        ),
        "virtual": (bool, "drive a virtual robot, simulated in the twin"),
        "robot": (Path, "the robot, with --virtual or --bus (robot.toml)"),
        "model": (Path, "servos and body of the virtual robot (MODEL.json)"),
        "seconds": (float, "longest time to swim, s", 20.0),
        "out": (Path, "recording of the swim to write (.csv)"),
    },
    "demo": {
        "data": (Path, "folder of recordings of the servos", Path("datasets/servo_steps")),
        "pool": (Path, "folder of recordings of the pool", Path("datasets/pool")),
        "out": (Path, "folder for the report", Path("reports/demo")),
        "train": (
            bool,
            "train the ablation's agents in this run, minutes on two cores (default: evaluate "
            "those shipped with the data)",
        ),
    },
}
"""By group and name: type, choices, or a list of one of them; help; default or ``required``."""
_METAVARS = {Path: "FILE", int: "N", float: "X", str: "TEXT"}


def _add(command: argparse.ArgumentParser, *groups: str) -> None:
    """Add the options of some groups."""
    for name, (kind, text, *default) in (x for g in groups for x in _OPTIONS[g].items()):
        options: dict[str, Any] = {}
        if isinstance(kind, list):
            (kind,), options["nargs"] = kind, "+"
        if kind is bool:
            options["action"] = "store_true"
        elif isinstance(kind, tuple):
            options["choices"] = kind
        else:
            options |= {"type": kind, "metavar": _METAVARS[kind]}
        if default == ["required"]:
            options["required"] = True
        elif default:
            options["default"] = default[0]
            text += f" (default {default[0]})"
        command.add_argument(f"--{name}", help=text, **options)


def _train(command: argparse.ArgumentParser) -> None:
    _add(command, "water", "train", "plan")
    add_executor(command, otherwise="all runs in one batch")


def _ablate(command: argparse.ArgumentParser) -> None:
    _add(command, "water", "ablate", "plan")
    add_executor(command, otherwise="all runs in one batch")


def _evaluate(command: argparse.ArgumentParser) -> None:
    command.add_argument("policies", nargs="+", metavar="POLICY", help=_POLICIES)
    _add(command, "water", "evaluate")


def _forecast(command: argparse.ArgumentParser) -> None:
    add_verb(command, verbs.forecast, positional=("policies",), leave_out=("kept",))
    add_file(command, "--out", "JSON", "forecast to write (forecast.json)", required=True)
    add_flag(command, "--no-page", "do not write the HTML page")


def _export(command: argparse.ArgumentParser) -> None:
    add_file(command, "policy", "POLICY", "trained policy (POLICY.zip)")
    _add(command, "export")


def _swim(command: argparse.ArgumentParser) -> None:
    add_file(command, "policy", "POLICY", "policy (policy.npz or policy.zip)")
    _add(command, "swim")


def _demo(command: argparse.ArgumentParser) -> None:
    _add(command, "demo")


_FISH = "--robot fish.toml --model model.json"
_COMMANDS = {
    "demo": (_demo, "--out reports/demo"),
    "train": (_train, f"--quick {_FISH} --out runs/quick"),
    "evaluate": (_evaluate, f"policy.zip pnl --task turn {_FISH}"),
    "ablate": (_ablate, f"{_FISH} --ranges ranges.json --reality reality.py --out runs/ablation"),
    "forecast": (
        _forecast,
        f"policy.zip {_FISH} --ranges ranges.json --limit 'time_s<=6@0.95' --out forecast.json",
    ),
    "export": (_export, "policy.zip --out policy.npz --format npz c"),
    "swim": (_swim, "policy.npz --target 1.2,-0.4 --port udp://192.168.4.1:4210 --out swim.csv"),
}
"""Options of each command, and those of its example."""
COMMANDS = tuple(
    Command(
        name, f"rl.commands.{name}", add, f"sim2real {name} {example}",
        resumes=name in ("train", "ablate", "forecast"),
    )
    for name, (add, example) in _COMMANDS.items()
)  # fmt: skip
