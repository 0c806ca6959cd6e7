"""The ablation's page, its Markdown and its figures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rl.experiments.ablation import bootstrap
from rl.experiments.arms import TITLES
from rl.experiments.differences import (
    OUTCOME,
    STILL,
    Difference,
    differences,
    seeds_needed,
)
from rl.sac.curve import draw_curves
from rl.sac.train import Plan
from sim2real.output import write_json, write_whole
from sim2real.report.page import Block, Note, Section, Table, Text, write_page
from sim2real.report.page import Figure as Picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Found = Mapping[str, Any]


def write_report(found: Found, plan: Plan, folder: Path, made: Mapping[str, Any]) -> None:
    """Write ``index.html``, ``ablation.md``, ``ablation.json``; ``curve.png`` after a training."""
    write_json(folder / "ablation.json", {**found, "table": rows(found)})
    write_whole(folder / "ablation.md", markdown(found) + "\n")
    trained: dict[str, list[Path]] = {}
    for agent in found["agents"]:
        for own in (folder / "train").rglob(agent["folder"]):
            if (own / "progress.csv").exists():
                trained.setdefault(TITLES[agent["arm"]], []).append(own)
    if trained:  # agents that were trained beforehand have no curves
        draw_curves(trained, folder / "curve.png")
    lead = f"{len(found['agents'])} agents of {plan.steps} steps in the {plan.fidelity}"
    write_page(folder / "index.html", "Ablation", lead, sections(found, plan), made)


def rows(found: Found) -> list[dict[str, Any]]:
    """One row an arm: means and 90 % intervals of return and reward by testbed, and so on."""
    out = []
    for arm in dict.fromkeys(agent["arm"] for agent in found["agents"]):
        own = [agent for agent in found["agents"] if agent["arm"] == arm]
        row: dict[str, Any] = {"arm": arm}
        for testbed in found["testbeds"]:
            row[testbed] = {
                name: bootstrap([a[testbed][name] for a in own], np.random.default_rng(0))
                for name in (OUTCOME, "reward")
            }
            row[testbed]["success"] = float(np.mean([a[testbed]["success"] for a in own]))
            for name in ("time_s", "energy"):
                row[testbed][name] = float(np.mean([a[testbed][name] for a in own]))
        out.append(row)
    return out


def markdown(found: Found) -> str:
    """The table as Markdown."""
    lines = [
        "| arm | simulation: return | arrives | reality: return | arrives | time (s) | energy "
        "| reward |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in rows(found):
        sim, real = (row[testbed] for testbed in found["testbeds"])
        lines.append(
            f"| {TITLES[row['arm']]} | {_mean(sim)} | {100 * sim['success']:.0f} % "
            f"| {_mean(real)} | {100 * real['success']:.0f} % | {real['time_s']:.1f} "
            f"| {real['energy']:.0f} | {real['reward'][0]:.1f} |"
        )
    lines += [
        "",
        "| arm | loses in reality, by seed (90 % interval) | sd over pairs | pairs | needed "
        "| no turn counted below 0 | sd | needed |",
        "|---|---|---|---|---|---|---|---|",
    ]
    told, kept = differences(found), differences(found, least=STILL)
    for arm, one in told.items():
        other = kept[arm]
        lines.append(
            f"| {TITLES[arm]} | {_ends(one)} | {one.sd:.2f} | {one.pairs} | {_many(told, arm)} "
            f"| {_ends(other)} | {other.sd:.2f} | {_many(kept, arm)} |"
        )
    return "\n".join(lines)


def _ends(one: Difference) -> str:
    return f"{one.mean:+.2f} ({one.low:+.2f} to {one.high:+.2f})"


def _many(told: Mapping[str, Difference], arm: str) -> str:
    count = seeds_needed(told)[arm]
    return "more than 200" if count is None else f"{count}"


def _mean(testbed: Mapping[str, Any]) -> str:
    mean, low, high = testbed[OUTCOME]
    return f"{mean:.2f} ({low:.2f} to {high:.2f})"


def sections(found: Found, plan: Plan) -> list[Section]:
    """What the page says."""
    table = rows(found)
    by = {row["arm"]: row for row in table}
    cells = [
        (
            TITLES[row["arm"]],
            *(
                cell
                for testbed in found["testbeds"]
                for cell in (
                    f"{row[testbed][OUTCOME][0]:.2f}\n{row[testbed][OUTCOME][1]:.2f} to "
                    f"{row[testbed][OUTCOME][2]:.2f}",
                    f"{100 * row[testbed]['success']:.0f} %",
                )
            ),
            f"{row['reality']['time_s']:.1f}",
            f"{row['reality']['energy']:.0f}",
        )
        for row in table
    ]
    header = ("arm", "return, simulation", "arrives", "return, reality", "arrives", "s", "energy")
    note = (
        "Rewards discounted as in training: means with 90 % intervals, agents and repeats "
        "resampled. Time and energy in reality, "
        "over all turns: one that does not arrive counts the whole time."
    )
    returns = Section(
        "What each technique is worth",
        keeps(by),
        [_picture(return_figure(table)), Table(header, cells, caption=note)],
    )
    told = differences(found)
    notes: list[Block] = [
        Note("good" if one.low > 0 else "warn" if one.high < 0 else "info", compared(arm, one))
        for arm, one in told.items()
    ]
    if told:
        notes.insert(0, _picture(difference_figure(told)))
        notes += [Note("info", power(told)), Note("info", floored(found))]
    if not any(row["reality"]["success"] for row in table):
        said = "No arm reached the target in reality: returns compare how far and how cheaply they "
        notes.insert(0, Note("warn", said + "turn towards it, not how fast they arrive."))
    ways = Section(
        "The turns",
        "Ways of the head in reality: two turns of each agent.",
        [_picture(way_figure(found))],
    )
    how = Text(
        f"Each agent: {plan.steps} steps of soft actor-critic at the task “{plan.task.name}”, "
        f"{plan.envs} environments, {plan.settings.updates_per_step:g} updates a step, energy "
        f"weight {plan.task.energy:g}; {found['repeats']} turns each in simulation and in reality. "
        f"Simulation: {found['said']['simulation']}. Reality: {found['said']['reality']}."
    )
    return [
        returns,
        Section("What is lost without it", _DIFFERENCES, notes),
        ways,
        Section("How", "", [how]),
    ]


def _picture(figure: Figure) -> Picture:
    """A figure for a page, and its layout for a phone."""
    from sim2real.report.drawing import svg
    from sim2real.report.style import NARROW

    return Picture(svg(figure), narrow=svg(figure, width=NARROW))


_DIFFERENCES = (
    "Return in reality of all techniques less that of each arm, agents paired by their seeds: the "
    "mean and its 90 % interval. An interval that leaves out zero tells the arms apart."
)


def compared(arm: str, one: Difference) -> str:
    """What an arm loses against all techniques, in a sentence."""
    word = "less" if one.mean > 0 else "more"
    said = f"{TITLES[arm]}: {abs(one.mean):.2f} {word} return in reality than all techniques"
    if one.pairs < 2:
        return f"{said}; one pair of agents tells nothing of chance"
    ends = sorted((abs(one.low), abs(one.high)))
    if one.told:
        return f"{said} ({ends[0]:.2f} to {ends[1]:.2f})"
    return f"{said} (90 % interval {-one.high:+.2f} to {-one.low:+.2f}, so it may be nothing)"


def power(told: Mapping[str, Difference]) -> str:
    """How many seeds tell the arms apart as well as was asked for."""
    largest = max(abs(one.mean) for one in told.values())
    parts = [
        f"{TITLES[arm]} {'more than 200' if count is None else count}"
        for arm, count in seeds_needed(told).items()
    ]
    pairs = list(dict.fromkeys(one.pairs for one in told.values()))
    seeds = f"{pairs[0]} seeds an arm" if len(pairs) == 1 else f"{min(pairs)} to {max(pairs)} seeds"
    return (
        f"{seeds}. For intervals narrower than a third of the largest difference "
        f"({largest:.2f}) the spread over pairs asks for: {', '.join(parts)}."
    )


def floored(found: Found) -> str:
    """What is lost where no turn counts for less than that of a robot that lies still."""
    kept = differences(found, least=STILL)
    needed = seeds_needed(kept)
    parts = [
        f"{TITLES[arm]} {_ends(one)}, {needed[arm] or 'more than 200'} seeds asked for"
        for arm, one in kept.items()
    ]
    said = "Where no turn counts for less than that of a robot that lies still, as one that "
    return f"{said}thrashes about is switched off: {'; '.join(parts)}."


def difference_figure(told: Mapping[str, Difference]) -> Figure:
    """Each arm's loss with its interval."""
    from sim2real.report.style import ACCENT, INK, MUTED, house_style, new_figure

    with house_style():
        figure = new_figure(70 + 34 * len(told), "Return lost in reality without each technique")
        axes = figure.subplots()
        for y, one in enumerate(told.values()):
            colour = ACCENT if one.told else MUTED
            ends = [[min(one.mean - one.low, 1e6)], [min(one.high - one.mean, 1e6)]]
            if one.pairs > 1:
                axes.errorbar([one.mean], [y], xerr=ends, fmt="none", ecolor=colour, lw=1.6)
            axes.plot([one.mean], [y], "o", color=colour, ms=4)
        axes.axvline(0, color=INK, lw=0.8)
        axes.margins(0.06, 0.2)
        axes.set_yticks(range(len(told)), [TITLES[arm] for arm in told])
        axes.invert_yaxis()
        axes.grid(visible=False, axis="y")
        axes.set_xlabel("return of all techniques\nless this arm's, in reality")
    return figure


def keeps(by: Mapping[str, Mapping[str, Any]]) -> str:
    """How much of its simulated reward the first arm keeps, in a sentence."""
    if "all" not in by:
        return ""
    sim, real = (by["all"][testbed][OUTCOME][0] for testbed in ("simulation", "reality"))
    said = f"With all techniques the return is {sim:.2f} in simulation and {real:.2f} in reality"
    said += f", {100 * real / sim:.0f} % of it." if sim > 0 else "."
    if "all-and-effects" in by and sim > real:
        more = by["all-and-effects"]["reality"][OUTCOME][0] - real
        said += f" With the effects found, {100 * more / (sim - real):.0f} % of the gap is closed."
    return said


def return_figure(table: list[dict[str, Any]]) -> Figure:
    """Return of each arm in simulation and in reality, with intervals."""
    from sim2real.report.style import ACCENT, FAINT, house_style, new_figure

    with house_style():
        figure = new_figure(60 + 46 * len(table), "Return of each arm in simulation and reality")
        axes = figure.subplots()
        for testbed, colour, off in (("simulation", FAINT, -0.17), ("reality", ACCENT, 0.17)):
            y = np.arange(len(table)) + off
            mean, low, high = np.array([row[testbed][OUTCOME] for row in table]).T
            axes.barh(y, mean, 0.3, color=colour, label=testbed)
            axes.errorbar(mean, y, xerr=[mean - low, high - mean], fmt="none", ecolor="0.2", lw=1)
        axes.set_yticks(range(len(table)), [TITLES[row["arm"]] for row in table])
        axes.invert_yaxis()
        axes.grid(axis="x")
        axes.grid(visible=False, axis="y")
        axes.set_xlabel(
            "discounted return of a 180 degree turn\nwith the target 1.5 m behind", loc="right"
        )
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
