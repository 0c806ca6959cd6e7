r"""Ablations that were trained in parts: swim all their agents in another reality, join the pages.

    python benchmarks/ablation_elsewhere.py RUN [RUN ...] --out FOLDER \
        --reality datasets/pool/reality.py --reality-cell-m 0.01 --device cuda:0
    python benchmarks/ablation_elsewhere.py FOLDER [FOLDER ...] --out WHOLE

A run is a folder of ``sim2real ablate``, in which ``train`` and, for the second form,
``ablation.json`` count. All runs have the same plan and arms, each seeds of its own. Without a
reality nothing swims: what the runs tell is joined as it is.
"""

from __future__ import annotations

import argparse
import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from harness import command_line

import sim2real as s2r
from rl.commands.ablate import make_testbeds
from rl.experiments.ablation import ablate, arm_of
from rl.experiments.ablation_report import markdown, write_report
from rl.experiments.reality import read_reality
from rl.observer import View
from rl.sac.plan import Plan, Settings
from rl.task import TASKS
from sim2real.output import provenance
from sim2real.ranges.entry import read_ranges

POOL = Path("datasets/pool")


def main() -> None:
    """Swim or join, and write the report."""
    parser = command_line(
        __doc__, reality=Path, reality_cell_m=0.01, cell_m=(float, "of each arm's own simulator"),
        device="cpu", repeats=8, longest=(int, "control periods of a trial (default 1000)"),
        at_once=(int, "robots in the reality (default: its own word)"), seed=0,
    )  # fmt: skip
    parser.add_argument("runs", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    torch.set_num_threads(1)
    plan, arms, folders = trained(options.runs)
    for name, folder in folders.items():
        own = options.out / "train" / name
        own.mkdir(parents=True, exist_ok=True)
        for file in ("progress.csv", "policy.npz"):
            if (folder / file).exists() and not (own / file).exists():
                shutil.copy(folder / file, own / file)
    found = swum(plan, arms, folders, options) if options.reality else joined(options.runs)
    write_report(found, plan, options.out, provenance([], options.seed))
    print(markdown(found))


def trained(runs: list[Path]) -> tuple[Plan, list[str], dict[str, Path]]:
    """The plan of all runs with the seeds of all, names of arms, folders of agents by name."""
    told = [json.loads((run / "train" / "run.json").read_text()) for run in runs]
    plans = [one["plan"] for one in told]
    seeds = tuple(seed for one in plans for seed in one["seeds"])
    first = {**plans[0], "seeds": seeds}
    if any({**one, "seeds": seeds, "device": first["device"]} != first for one in plans):
        raise SystemExit("the runs were not trained alike")
    parts = {
        "task": replace(TASKS[first["task"]["name"]], energy=first["task"]["energy"]),
        "settings": Settings(**{key: tupled(one) for key, one in first["settings"].items()}),
        "view": View(**first["view"]),
        "ramp": tupled(first["ramp"]),
    }
    plan = Plan(**{**first, **parts})
    folders = {
        name: run / "train" / name
        for run, one in zip(runs, told, strict=True)
        for name in one["agents"]
    }
    arms = list(dict.fromkeys(name.rsplit("-", 1)[0] for name in told[0]["agents"]))
    return plan, arms, folders


def tupled(value: Any) -> Any:  # noqa: ANN401 - of JSON
    """Lists are tuples in a plan."""
    return tuple(value) if isinstance(value, list) else value


def swum(
    plan: Plan, names: list[str], folders: dict[str, Path], options: argparse.Namespace
) -> dict[str, Any]:
    """All agents in their simulators and in the reality."""
    robot, model = s2r.read_robot(POOL / "robot.toml"), s2r.read_model(POOL / "calibrated.json")
    ranges = read_ranges(POOL / "ranges.json")
    enriched, truth = (s2r.read_model(POOL / f"{one}.json") for one in ("enriched", "reality"))
    arms = [arm_of(name, model, robot, ranges, enriched, truth) for name in names]
    plan = replace(plan, device=options.device, cell_m=options.cell_m or plan.cell_m)
    reality = read_reality(options.reality, cell_m=options.reality_cell_m)
    reality = replace(reality, at_once=options.at_once or reality.at_once)
    testbeds = make_testbeds(robot, arms, plan, ranges, reality)
    agents = [folders[f"{arm}-{seed}"] for arm in names for seed in plan.seeds]
    return ablate(
        options.out, robot, names, agents, plan, testbeds, repeats=options.repeats,
        seed=options.seed, longest=options.longest,
    )  # fmt: skip


def joined(runs: list[Path]) -> dict[str, Any]:
    """What several runs tell, as one."""
    told = [json.loads((run / "ablation.json").read_text()) for run in runs]
    whole = {key: told[0][key] for key in ("repeats", "testbeds", "said", "targets")}
    agents = [agent for one in told for agent in one["agents"]]
    order = list(dict.fromkeys(agent["arm"] for agent in agents))
    agents.sort(key=lambda agent: (order.index(agent["arm"]), agent["seed"]))
    return {**whole, "agents": agents}


if __name__ == "__main__":
    main()
