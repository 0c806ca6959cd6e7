"""Time against energy: policies trained at several weights of energy, and the controllers' paces.

    python benchmarks/energy_curve.py --out reports/training/curve [--device cuda:0] [--seeds 2]

All weights and seeds learn side by side in one batch, in the twin calibrated to a shipped swim;
then policies and controllers swim the same randomized trials of each task. ``--fidelity fluid``
does the same in the fluid, ``--trained NAME=FOLDER ...`` tries what runs have trained already
(without ``NAME=`` by the names of their agents), ``--prices 0.5 1 2`` each of those at several
prices of energy, joined by a line.
Writes ``TASK.json`` and ``curve.png``: who is left and below the others wins.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from harness import command_line
from training_tables import group_of

import sim2real as s2r
from rl.controllers import Controller
from rl.controllers.classical import PACES
from rl.experiments.episodes import summary
from rl.experiments.named import controller_of
from rl.experiments.testbeds import SimulationSettings, run_trials
from rl.make import draws_of
from rl.sac.plan import RECIPES, plan_of
from rl.sac.train import Arm, train
from rl.task import TASKS
from sim2real.output import provenance, write_json
from sim2real.ranges.entry import read_ranges
from sim2real.report.style import ACCENT, INK, MUTED, house_style, new_figure

POOL = Path("datasets/pool")
WEIGHTS = (3e-4, 6e-4, 1e-3, 1.5e-3, 2.5e-3)
MARKS = {"pnl": "s", "adrc": "D"}
ELSEWHERE = {"pnl": "pnl tuned in the fluid", "adrc": "adrc tuned in the fluid"}
"""Names of rows of gains from another place, drawn in outline where there are any."""


def main() -> None:
    """Train, try, draw."""
    parser = command_line(
        __doc__, device="cpu", cell_m=0.02, weights=list(WEIGHTS), seeds=2, seed=500, steps=int,
        envs=int, segment=int, updates_per_step=float, tasks=["turn", "pentagram"], episodes=30,
        gains=Path, draw_only=(False, "from the JSON that is there"),
    )  # fmt: skip
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--fidelity", choices=("twin", "fluid"), default="twin")
    parser.add_argument("--trained", nargs="+", metavar="[NAME=]FOLDER", default=[])
    parser.add_argument("--prices", type=float, nargs="+", help="of those trained, policy.zip each")
    options = parser.parse_args()
    torch.set_num_threads(1)
    if not options.draw_only:
        make(options)
    draw(read(options), options.out / "curve.png")


def read(options: argparse.Namespace) -> dict[str, Any]:
    """Results by task and simulator, of ``make`` or of ``sim2real evaluate``."""
    files = [json.loads((options.out / f"{name}.json").read_text()) for name in options.tasks]
    return {f"{one['task']}, {one['fidelity']}": one["results"] for one in files}


def make(options: argparse.Namespace) -> None:
    """Train one agent a weight and seed, swim every task, and write its results."""
    robot, model = s2r.read_robot(POOL / "robot.toml"), s2r.read_model(POOL / "calibrated.json")
    ranges = read_ranges(POOL / "ranges.json")
    water: Any = {
        "fidelity": options.fidelity, "device": options.device, "cell_m": options.cell_m,
    }  # fmt: skip
    agents = known(options.trained, options.prices)
    if not agents:
        seeds = tuple(range(options.seed, options.seed + options.seeds))
        plan = plan_of(vars(options), seeds=seeds, **water)
        draws = draws_of(model, ranges, robot, seed=0)
        arms = [Arm(f"energy-{weight:g}", draws, weight) for weight in options.weights]
        folders = train(options.out / "train", robot, arms, plan)
        agents = {f"{one.name}/policy.zip": str(one / "policy.zip") for one in folders}
    limits = [joint.limits_rad for joint in robot.joints]
    for task in options.tasks:
        n = options.episodes if task != "pentagram" else max(options.episodes // 3, 1)
        controllers: dict[str, Controller] = {}
        for name, path in agents.items():
            controllers[name] = controller_of(path, limits, n)
        for kind in MARKS:
            for pace in PACES:
                name = f"{kind}-{pace}"
                controllers[name] = controller_of(name, limits, n, gains=options.gains)
        own = replace(TASKS[task], energy=RECIPES["default"].energy)
        swims = run_trials(
            robot, model, ranges, own, controllers, episodes=n, seed=7,
            settings=SimulationSettings(**water),
        )  # fmt: skip
        results = {name: summary(one, own) for name, one in swims.items()}
        content = {"task": task, "fidelity": options.fidelity, "randomized": True}
        content |= {"results": results, "provenance": provenance([], options.seed)}
        write_json(options.out / f"{task}.json", content)


def known(trained: list[str], prices: list[float] | None) -> dict[str, str]:
    """Policies by "NAME-K/FILE", from "NAME=FOLDER" of runs, and at each of the prices.

    Those of a "FOLDER" alone are called by the folders of its agents, "ARM-SEED/FILE".
    """
    out = {}
    for one in trained:
        name, _, folder = one.rpartition("=")
        for k, path in enumerate(sorted(Path(folder).rglob("policy.*"))):
            agent = f"{name}-{k}" if name else path.parent.name
            for price in [f"@{x:g}" for x in prices or ()] or [""]:
                out[f"{agent}/{path.name}{price}"] = f"{path}{price}"
    return out


def draw(found: Mapping[str, Mapping[str, Any]], path: Path) -> None:
    """A panel a task: every policy and every pace of a controller."""
    with house_style():
        figure = new_figure(330, "Time against energy of policies and controllers")
        panels = figure.subplots(1, len(found), squeeze=False)[0]
        for axes, (task, rows) in zip(panels, found.items(), strict=True):
            axes.set_title(task)
            axes.set(xlabel="energy (1000 rad²/s²)", ylabel="time (s)", xscale="log", yscale="log")
            _policies(axes, rows)
            for kind, mark in MARKS.items():
                colour = INK if kind == "pnl" else MUTED
                for name, full in ((kind, colour), (ELSEWHERE[kind], "none")):
                    paces = [f"{name}-{pace}" for pace in PACES]
                    if name in rows:  # the middle one, as a command line calls it
                        paces[1] = name
                    own = [rows[pace] for pace in paces if pace in rows]
                    points = [(one["energy"] / 1e3, one["time_s"]) for one in own]
                    style: Any = {"marker": mark, "color": colour, "markerfacecolor": full}
                    if points:
                        label = kind.upper() + name.removeprefix(kind)
                        axes.plot(*np.array(points).T, "--", lw=0.9, ms=4.5, label=label, **style)
            axes.margins(0.08)
            _plain_ticks(axes)
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=3)
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=144)


def _policies(axes: Any, rows: Mapping[str, Any]) -> None:  # noqa: ANN401
    """All of them, and the mean of each group of seeds."""
    own: dict[str, list[Any]] = {}
    lines: dict[str, list[tuple[float, float]]] = {}
    for name, row in rows.items():
        file, at, price = name.partition("@")
        if group := group_of(file):
            own.setdefault(group + (at and f" {price}"), []).append(row)
            lines.setdefault(file, []).append((row["energy"] / 1e3, row["time_s"]))
    priced = any(len(one) > 1 for one in lines.values())
    for one in lines.values():
        axes.plot(*np.array(one).T, color=ACCENT, lw=0.5, alpha=0.4)
    means = []
    for k, (name, some) in enumerate(own.items()):
        points = np.array([(one["energy"] / 1e3, one["time_s"]) for one in some])
        x, y = points.mean(axis=0)
        means.append((x, y))
        label = "policies, each seed and the mean" if k == 0 else None
        axes.plot(*points.T, "o", color=ACCENT, ms=3, alpha=0.5)
        axes.plot([x], [y], "o", color=ACCENT, ms=6, label=label)
        if len(own) > 1 and not priced:
            axes.annotate(
                name.removeprefix("energy-"), (x, y), (-6, -10), textcoords="offset points",
                color=ACCENT, ha="right", fontsize=7,
            )  # fmt: skip
    if priced:
        axes.plot(*np.array(means).T, color=ACCENT, lw=1.5)


def _plain_ticks(axes: Any) -> None:  # noqa: ANN401
    from matplotlib.ticker import FuncFormatter, LogLocator

    for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        few = high / low > 4
        axis.set_major_locator(LogLocator(subs=(1, 2, 5) if few else (1, 2, 3, 4, 5, 6, 8)))
        axis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
        axis.set_minor_formatter(FuncFormatter(lambda *_: ""))
    axes.tick_params(which="minor", length=0)


if __name__ == "__main__":
    main()
