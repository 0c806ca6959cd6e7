"""Report of the ablation: HTML page, Markdown tables and figures of the same rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rl.experiments.ablation import ARMS
from rl.experiments.paths import aligned, paths_figure
from rl.experiments.statistics import OUTCOME, bootstrap, differences, seeds_needed
from rl.sac.checkpoint import draw_curves
from rl.sac.plan import Plan
from sim2real.output import write_json, write_whole
from sim2real.report.drawing import svg
from sim2real.report.page import Block, Note, Section, Table, Text, write_page
from sim2real.report.page import Figure as Picture
from sim2real.report.style import ACCENT, FAINT, INK, house_style, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Results = Mapping[str, Any]

_RETURNS = (
    "Rewards discounted as in training: means with 90 % bootstrap intervals over agents and "
    "repeats. Time, energy and reward are those in reality, "
    "over all turns: a turn that does not arrive counts with the full duration of the task."
)
_DIFFERENCES = (
    "Return in reality with all techniques minus that of each arm, agents paired by seed: mean and "
    "90 % interval, positive if the arm is worse. A loss is significant if its interval excludes "
    "zero. Needed are the seeds for an interval narrower than a third of the largest loss."
)


def write_report(results: Results, plan: Plan, folder: Path, note: Mapping[str, Any]) -> None:
    """Write ``index.html``, ``ablation.md``, ``ablation.json``; ``curve.png`` if agents trained."""
    losses = {arm: asdict(loss) for arm, loss in differences(results).items()}
    write_json(folder / "ablation.json", {**results, "table": rows(results), "losses": losses})
    write_whole(folder / "ablation.md", markdown(results) + "\n")
    trained: dict[str, list[Path]] = {}
    for agent in results["agents"]:
        for run in (folder / "train").rglob(agent["folder"]):
            if (run / "progress.csv").exists():
                trained.setdefault(ARMS[agent["arm"]].title, []).append(run)
    if trained:  # pretrained agents have no curves
        draw_curves(trained, folder / "curve.png")
    lead = f"{len(results['agents'])} agents of {plan.steps} steps in the {plan.fidelity}"
    write_page(folder / "index.html", "Ablation", lead, sections(results, plan), note)


def rows(results: Results) -> list[dict[str, Any]]:
    """One row per arm: by testbed, means with 90 % intervals of return and reward, other means."""
    out = []
    for arm in dict.fromkeys(agent["arm"] for agent in results["agents"]):
        agents = [agent for agent in results["agents"] if agent["arm"] == arm]
        row: dict[str, Any] = {"arm": arm}
        for testbed in results["testbeds"]:
            row[testbed] = {
                name: bootstrap([a[testbed][name] for a in agents], np.random.default_rng(0))
                for name in (OUTCOME, "reward")
            }
            for name in ("success", "time_s", "energy"):
                row[testbed][name] = float(np.mean([a[testbed][name] for a in agents]))
        out.append(row)
    return out


def tables(results: Results) -> dict[str, Table]:
    """The tables of the report: ``returns`` and ``losses``."""
    table, returns = rows(results), []
    for row in table:
        cells = [ARMS[row["arm"]].title]
        for testbed in results["testbeds"]:
            arrives = f"{100 * row[testbed]['success']:.0f} %"
            cells += [_ends(row[testbed][OUTCOME]), arrives]
        real = row["reality"]
        cells += [f"{real['time_s']:.1f}", f"{real['energy']:.0f}", f"{real['reward'][0]:.1f}"]
        returns.append(cells)
    header = ("arm", "return, simulation", "arrives", "return, reality", "arrives", "time (s)",
              "energy", "reward")  # fmt: skip
    losses = differences(results)
    needed = {arm: S or "more than 200" for arm, S in seeds_needed(losses).items()}
    lost = [
        (ARMS[arm].title, _ends((x.mean, x.low, x.high), "+.2f"), "yes" if x.significant else "no",
         f"{x.sd:.2f}", str(x.pairs), str(needed[arm]))
        for arm, x in losses.items()
    ]  # fmt: skip
    titles = ("arm", "loses in reality, by seed", "significant", "sd over pairs", "pairs", "needed")
    return {"returns": Table(header, returns, _RETURNS), "losses": Table(titles, lost)}


def _ends(values: Sequence[float], shape: str = ".2f") -> str:
    """A mean, and its interval on the line below."""
    mean, low, high = (f"{x:{shape}}" for x in values)
    return f"{mean}\n{low} to {high}"


def markdown(results: Results) -> str:
    """The tables as Markdown."""
    parts = []
    for table in tables(results).values():
        lines = [table.header, ["---"] * len(table.header), *table.rows]
        parts.append("\n".join(f"| {' | '.join(x)} |".replace("\n", "; ") for x in lines))
    return "\n\n".join(parts)


def sections(results: Results, plan: Plan) -> list[Section]:
    """Sections of the page."""
    made, table = tables(results), rows(results)
    lost: list[Block] = [made["losses"]]
    if not any(row["reality"]["success"] for row in table):
        warning = (
            "No arm reached the target in reality: returns compare how far the robot turns towards "
            "it and with how much energy, not arrival times."
        )
        lost.insert(0, Note("warn", warning))
    method = Text(
        f"Each agent: {plan.steps} steps of soft actor-critic at the task “{plan.task.name}”, "
        f"{plan.envs} environments, {plan.settings.updates_per_step:g} updates a step, energy "
        f"weight {plan.task.energy:g}; {results['repeats']} turns each in simulation and in "
        f"reality. Simulation: {results['said']['simulation']}. "
        f"Reality: {results['said']['reality']}."
    )
    effect: list[Block] = [picture(return_figure(table)), made["returns"]]
    lead = "Trajectories of the head in reality: two turns of each agent."
    return [
        Section(
            "Effect of each technique", retention_text({row["arm"]: row for row in table}), effect
        ),
        Section("Loss without each technique", _DIFFERENCES, lost),
        Section("The turns", lead, [picture(trajectory_figure(results))]),
        Section("Method", "", [method]),
    ]


def picture(figure: Figure) -> Picture:
    """A figure for a page."""
    return Picture(svg(figure))


def retention_text(by_arm: Mapping[str, Mapping[str, Any]]) -> str:
    """The share of its simulated return that arm "all" keeps in reality, as a sentence."""
    if "all" not in by_arm:
        return ""
    sim, real = (by_arm["all"][testbed][OUTCOME][0] for testbed in ("simulation", "reality"))
    text = f"With all techniques the return is {sim:.2f} in simulation and {real:.2f} in reality"
    text += f", {100 * real / sim:.0f} % of it." if sim > 0 else "."
    if "all-and-effects" in by_arm and sim > real:
        gain = by_arm["all-and-effects"]["reality"][OUTCOME][0] - real
        text += f" With the effects found, {100 * gain / (sim - real):.0f} % of the gap is closed."
    return text


def return_figure(table: list[dict[str, Any]]) -> Figure:
    """Return of each arm in simulation and in reality, with intervals."""
    with house_style():
        figure = new_figure(60 + 46 * len(table), "Return of each arm in simulation and reality")
        axes = figure.subplots()
        for testbed, colour, offset in (("simulation", FAINT, -0.17), ("reality", ACCENT, 0.17)):
            y = np.arange(len(table)) + offset
            mean, low, high = np.array([row[testbed][OUTCOME] for row in table]).T
            axes.barh(y, mean, 0.3, color=colour, label=testbed)
            axes.errorbar(mean, y, xerr=[mean - low, high - mean], fmt="none", ecolor="0.2", lw=1)
        axes.set_yticks(range(len(table)), [ARMS[row["arm"]].title for row in table])
        axes.invert_yaxis()
        axes.grid(axis="x")
        axes.grid(visible=False, axis="y")
        axes.set_xlabel(
            "discounted return of a 180 degree turn\nwith the target 1.5 m behind", loc="right"
        )
        figure.legend(*axes.get_legend_handles_labels(), loc="outside upper right", ncols=2)
    return figure


def trajectory_figure(results: Results) -> Figure:
    """Trajectories in reality, one panel per arm, that of all techniques highlighted."""
    targets = np.array(results["targets"]["reality"])
    ways: dict[str, list[Any]] = {}
    for agent in results["agents"]:
        colour = ACCENT if agent["arm"] == "all" else INK
        ways.setdefault(ARMS[agent["arm"]].title, []).extend(
            aligned(np.array(path), target, colour)
            for path, target in zip(agent["reality"]["path"], targets, strict=False)
        )
    label, limits = "Trajectories of the head in reality, by arm", ((-1.7, 0.6), (-0.5, 0.5))
    return paths_figure(ways, label, away_m=[1.5], limits=limits)
