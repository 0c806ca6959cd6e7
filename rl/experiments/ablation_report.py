"""The ablation's page, its Markdown and its figures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rl.experiments.ablation import bootstrap
from rl.experiments.arms import TITLES
from rl.sac.curve import draw_curves
from rl.sac.train import Plan
from sim2real.output import write_json, write_whole
from sim2real.report.page import Block, Note, Section, Table, Text, write_page
from sim2real.report.page import Figure as Picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Found = Mapping[str, Any]


def write_report(found: Found, plan: Plan, folder: Path, made: Mapping[str, Any]) -> None:
    """Write ``index.html``, ``ablation.md``, ``ablation.json`` and ``curve.png``."""
    write_json(folder / "ablation.json", {**found, "table": rows(found)})
    write_whole(folder / "ablation.md", markdown(found) + "\n")
    trained: dict[str, list[Path]] = {}
    for agent in found["agents"]:
        own = next(
            p for p in (folder / "train").rglob(agent["folder"]) if (p / "policy.zip").exists()
        )
        trained.setdefault(TITLES[agent["arm"]], []).append(own)
    draw_curves(trained, folder / "curve.png")
    lead = f"{len(found['agents'])} agents of {plan.steps} steps in the {plan.fidelity}"
    write_page(folder / "index.html", "Ablation", lead, sections(found, plan), made)


def rows(found: Found) -> list[dict[str, Any]]:
    """One row an arm: means and 90 % intervals of the reward by place, success, time, energy."""
    out = []
    for arm in dict.fromkeys(agent["arm"] for agent in found["agents"]):
        own = [agent for agent in found["agents"] if agent["arm"] == arm]
        row: dict[str, Any] = {"arm": arm}
        for place in found["places"]:
            rng = np.random.default_rng(0)
            row[place] = {"reward": bootstrap([a[place]["reward"] for a in own], rng)}
            row[place]["success"] = float(np.mean([a[place]["success"] for a in own]))
            for name in ("time_s", "energy"):
                known = [x for a in own for x in a[place][name] if x is not None]
                row[place][name] = float(np.mean(known)) if known else None
        out.append(row)
    return out


def worth(found: Found, place: str = "reality") -> dict[str, tuple[float, float, float]]:
    """What "all techniques" gains over each other arm in reality: mean and 90 % interval."""
    rng = np.random.default_rng(1)
    reward = {
        arm: np.array([a[place]["reward"] for a in found["agents"] if a["arm"] == arm])
        for arm in dict.fromkeys(agent["arm"] for agent in found["agents"])
    }
    out: dict[str, tuple[float, float, float]] = {}
    for arm, values in reward.items():
        if arm == "all" or "all" not in reward:
            continue
        draws = [_resampled(reward["all"], rng) - _resampled(values, rng) for _ in range(4000)]
        low, high = np.quantile(draws, [0.05, 0.95])
        out[arm] = (float(reward["all"].mean() - values.mean()), float(low), float(high))
    return out


def _resampled(values: np.ndarray[Any, Any], rng: np.random.Generator) -> float:
    A, R = values.shape
    return float(values[rng.integers(A, size=A)[:, None], rng.integers(R, size=(A, R))].mean())


def markdown(found: Found) -> str:
    """The table as Markdown."""
    lines = [
        "| arm | simulation: reward | arrives | reality: reward | arrives | time (s) | energy |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in rows(found):
        sim, real = (row[place] for place in found["places"])
        lines.append(
            f"| {TITLES[row['arm']]} | {_mean(sim)} | {100 * sim['success']:.0f} % "
            f"| {_mean(real)} | {100 * real['success']:.0f} % | {_known(real['time_s'], 1)} "
            f"| {_known(real['energy'], 0)} |"
        )
    return "\n".join(lines)


def _mean(place: Mapping[str, Any]) -> str:
    mean, low, high = place["reward"]
    return f"{mean:.1f} ({low:.1f} to {high:.1f})"


def _known(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def sections(found: Found, plan: Plan) -> list[Section]:
    """What the page says."""
    from sim2real.report.drawing import svg

    table = rows(found)
    by = {row["arm"]: row for row in table}
    cells = [
        (
            TITLES[row["arm"]],
            *(
                cell
                for place in found["places"]
                for cell in (
                    f"{row[place]['reward'][0]:.1f}\n{row[place]['reward'][1]:.1f} to "
                    f"{row[place]['reward'][2]:.1f}",
                    f"{100 * row[place]['success']:.0f} %",
                )
            ),
            _known(row["reality"]["time_s"], 1),
            _known(row["reality"]["energy"], 0),
        )
        for row in table
    ]
    header = ("arm", "reward, simulation", "arrives", "reward, reality", "arrives", "s", "energy")
    note = (
        "Means with 90 % intervals, agents and their repeats resampled; time and energy in reality."
    )
    rewards = Section(
        "What each technique is worth",
        keeps(by),
        [Picture(svg(reward_figure(table))), Table(header, cells, caption=note)],
    )
    differences: list[Block] = [
        Note("good" if low > 0 else "warn" if high < 0 else "info", compared(arm, mean, low, high))
        for arm, (mean, low, high) in worth(found).items()
    ]
    if not any(row["reality"]["success"] for row in table):
        said = "No arm reached the target in reality: rewards compare how far and how cheaply they "
        differences.insert(0, Note("warn", said + "turn towards it, not how fast they arrive."))
    ways = Section(
        "The turns",
        "Ways of the head in reality: two turns of each agent.",
        [Picture(svg(way_figure(found)))],
    )
    how = Text(
        f"Each agent: {plan.steps} steps of soft actor-critic at the task “{plan.task.name}”, "
        f"{plan.envs} environments, {plan.settings.updates_per_step:g} updates a step, energy "
        f"weight {plan.task.energy:g}; {found['repeats']} turns each in simulation and in reality. "
        f"Simulation: {found['said']['simulation']}. Reality: {found['said']['reality']}."
    )
    return [rewards, Section("Differences", "", differences), ways, Section("How", "", [how])]


def compared(arm: str, mean: float, low: float, high: float) -> str:
    """What an arm loses against all techniques, in a sentence."""
    ends = f"{min(abs(low), abs(high)):.1f} to {max(abs(low), abs(high)):.1f}"
    if low < 0 < high:
        ends = f"90 % interval {-high:+.1f} to {-low:+.1f}, so it may be nothing"
    word = "less" if mean > 0 else "more"
    return f"{TITLES[arm]}: {abs(mean):.1f} {word} reward in reality than all techniques ({ends})"


def keeps(by: Mapping[str, Mapping[str, Any]]) -> str:
    """How much of its simulated reward the first arm keeps, in a sentence."""
    if "all" not in by:
        return ""
    sim, real = (by["all"][place]["reward"][0] for place in ("simulation", "reality"))
    said = f"With all techniques the reward is {sim:.1f} in simulation and {real:.1f} in reality"
    said += f", {100 * real / sim:.0f} % of it." if sim > 0 else "."
    if "all-and-effects" in by and sim > real:
        more = by["all-and-effects"]["reality"]["reward"][0] - real
        said += f" With the effects found, {100 * more / (sim - real):.0f} % of the gap is closed."
    return said


def reward_figure(table: list[dict[str, Any]]) -> Figure:
    """Reward of each arm in simulation and in reality, with intervals."""
    from sim2real.report.style import ACCENT, FAINT, house_style, new_figure

    with house_style():
        figure = new_figure(60 + 46 * len(table), "Reward of each arm in simulation and reality")
        axes = figure.subplots()
        for place, colour, off in (("simulation", FAINT, -0.17), ("reality", ACCENT, 0.17)):
            y = np.arange(len(table)) + off
            mean, low, high = np.array([row[place]["reward"] for row in table]).T
            axes.barh(y, mean, 0.3, color=colour, label=place)
            axes.errorbar(mean, y, xerr=[mean - low, high - mean], fmt="none", ecolor="0.2", lw=1)
        axes.set_yticks(range(len(table)), [TITLES[row["arm"]] for row in table])
        axes.invert_yaxis()
        axes.grid(axis="x")
        axes.grid(visible=False, axis="y")
        axes.set_xlabel("reward of a 180 degree turn with the target 1.5 m behind")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside upper right", ncols=2)
    return figure


def way_figure(found: Found) -> Figure:
    """Trajectories in reality, a panel an arm."""
    from sim2real.report.style import ACCENT, FAINT, INK, house_style, new_figure

    arms = list(dict.fromkeys(agent["arm"] for agent in found["agents"]))
    with house_style():
        rows = -(-len(arms) // 2)
        figure = new_figure(170 * rows, "Ways of the head in reality, arm by arm")
        panels = figure.subplots(rows, 2, sharex=True, sharey=True, squeeze=False).ravel()
        for axes in panels[len(arms) :]:
            axes.set_visible(False)
        for axes, arm in zip(panels, arms, strict=False):
            for agent in found["agents"]:
                if agent["arm"] != arm:
                    continue
                for n, path in enumerate(agent["reality"]["path"]):
                    way = _turned(np.array(path), np.array(found["targets"]["reality"][n]))
                    axes.plot(*way.T, color=ACCENT if arm == "all" else INK, lw=0.7, alpha=0.7)
            axes.plot([-1.5], [0], "o", mfc="none", mec=FAINT)
            axes.plot([0], [0], "o", color=INK, markersize=3)
            axes.set(aspect="equal", xlim=(-1.7, 0.6), ylim=(-0.5, 0.5))
            axes.set_title(TITLES[arm])
    return figure


def _turned(way: np.ndarray[Any, Any], target: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """The way with its start at the origin and the target behind it on the x axis."""
    along = target - way[0]
    along = along / np.linalg.norm(along)
    moved = way - way[0]
    return np.stack([-moved @ along, moved @ np.array([-along[1], along[0]])], axis=1)
