"""Report of the ablation: HTML page, Markdown tables and figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rl.experiments.ablation import bootstrap
from rl.experiments.arms import TITLES
from rl.experiments.differences import OUTCOME, STILL, Difference, differences, seeds_needed
from rl.experiments.predicted import HEADER, predicted_rows
from rl.sac.curve import draw_curves
from rl.sac.train import Plan
from sim2real.output import write_json, write_whole
from sim2real.report.page import Block, Note, Section, Table, Text, write_page
from sim2real.report.page import Figure as Picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Results = Mapping[str, Any]


def write_report(results: Results, plan: Plan, folder: Path, note: Mapping[str, Any]) -> None:
    """Write ``index.html``, ``ablation.md``, ``ablation.json``; ``curve.png`` if agents trained.

    ``losses`` in the JSON are the same as in text, table and figure: positive if an arm is worse.
    """
    losses = {arm: asdict(loss) for arm, loss in differences(results).items()}
    write_json(folder / "ablation.json", {**results, "table": rows(results), "losses": losses})
    write_whole(folder / "ablation.md", markdown(results) + "\n")
    trained: dict[str, list[Path]] = {}
    for agent in results["agents"]:
        for run in (folder / "train").rglob(agent["folder"]):
            if (run / "progress.csv").exists():
                trained.setdefault(TITLES[agent["arm"]], []).append(run)
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
            row[testbed]["success"] = float(np.mean([a[testbed]["success"] for a in agents]))
            for name in ("time_s", "energy"):
                row[testbed][name] = float(np.mean([a[testbed][name] for a in agents]))
        out.append(row)
    return out


def markdown(results: Results) -> str:
    """The tables as Markdown."""
    lines = [
        "| arm | simulation: return | arrives | reality: return | arrives | time (s) | energy "
        "| reward |",
        "|---|---|---|---|---|---|---|---|",
    ]
    table = rows(results)
    for row in table:
        sim, real = (row[testbed] for testbed in results["testbeds"])
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
    losses, floored_losses = differences(results), differences(results, floor=STILL)
    for arm, loss in losses.items():
        bounded = floored_losses[arm]
        lines.append(
            f"| {TITLES[arm]} | {_ends(loss)} | {loss.sd:.2f} | {loss.pairs} "
            f"| {_count(losses, arm)} | {_ends(bounded)} | {bounded.sd:.2f} "
            f"| {_count(floored_losses, arm)} |"
        )
    if predicted := predicted_rows(results, table):
        lines += ["", "| " + " | ".join(HEADER) + " |", "|---" * len(HEADER) + "|"]
        lines += ["| " + " | ".join(x.replace("\n", ", ") for x in row) + " |" for row in predicted]
    return "\n".join(lines)


def _ends(loss: Difference) -> str:
    return f"{loss.mean:+.2f} ({loss.low:+.2f} to {loss.high:+.2f})"


def _count(losses: Mapping[str, Difference], arm: str) -> str:
    count = seeds_needed(losses)[arm]
    return "more than 200" if count is None else f"{count}"


def _mean(testbed: Mapping[str, Any]) -> str:
    mean, low, high = testbed[OUTCOME]
    return f"{mean:.2f} ({low:.2f} to {high:.2f})"


def sections(results: Results, plan: Plan) -> list[Section]:
    """Sections of the page."""
    table = rows(results)
    by_arm = {row["arm"]: row for row in table}
    cells = [
        (
            TITLES[row["arm"]],
            *(
                cell
                for testbed in results["testbeds"]
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
        "Rewards discounted as in training: means with 90 % bootstrap intervals over agents and "
        "repeats. Time and energy are those in reality, "
        "over all turns: a turn that does not arrive counts with the full duration of the task."
    )
    returns = Section(
        "Effect of each technique",
        retention_text(by_arm),
        [picture(return_figure(table)), Table(header, cells, caption=note)],
    )
    losses = differences(results)
    notes: list[Block] = [
        Note("good" if loss.low > 0 else "warn" if loss.high < 0 else "info", loss_text(arm, loss))
        for arm, loss in losses.items()
    ]
    if losses:
        notes.insert(0, picture(difference_figure(losses)))
        notes += [Note("info", seeds_text(losses)), Note("info", floored_text(results))]
    if not any(row["reality"]["success"] for row in table):
        warning = (
            "No arm reached the target in reality: returns compare how far the robot turns towards "
        )
        notes.insert(0, Note("warn", warning + "it and with how much energy, not arrival times."))
    trajectories = Section(
        "The turns",
        "Trajectories of the head in reality: two turns of each agent.",
        [picture(trajectory_figure(results))],
    )
    method = Text(
        f"Each agent: {plan.steps} steps of soft actor-critic at the task “{plan.task.name}”, "
        f"{plan.envs} environments, {plan.settings.updates_per_step:g} updates a step, energy "
        f"weight {plan.task.energy:g}; {results['repeats']} turns each in simulation and in "
        f"reality. Simulation: {results['said']['simulation']}. "
        f"Reality: {results['said']['reality']}."
    )
    predicted = predicted_rows(results, table)
    forecast = [Section("Forecast", _FORECAST, [Table(HEADER, predicted)])] if predicted else []
    return [
        returns,
        *forecast,
        Section("Loss without each technique", _DIFFERENCES, notes),
        trajectories,
        Section("Method", "", [method]),
    ]


def picture(figure: Figure) -> Picture:
    """A figure for a page, with a narrow version for small screens."""
    from sim2real.report.drawing import svg

    return Picture(svg(figure))


_FORECAST = (
    "Rewards that were predicted from the model and its ranges alone, without the reality: mean of "
    "many turns with the 90 % interval over drawn realities, and the reward measured in reality. "
    "Lost is the reward of all techniques minus that of the arm."
)
_DIFFERENCES = (
    "Return in reality with all techniques minus that of each arm, agents paired by seed: mean and "
    "90 % interval, positive if the arm is worse. A loss is significant if its interval excludes "
    "zero."
)


def loss_text(arm: str, loss: Difference) -> str:
    """The loss of an arm relative to all techniques, as a sentence; positive if it is worse."""
    text = f"{TITLES[arm]}: loss of return in reality"
    if loss.pairs < 2:
        return f"{text} {loss.mean:+.2f}; one pair of agents gives no interval"
    return f"{text} {_ends(loss)}{'' if loss.significant else ', not significant'}"


def seeds_text(losses: Mapping[str, Difference]) -> str:
    """Number of seeds for intervals as narrow as ``SHARE`` asks, as a sentence."""
    largest = max(abs(loss.mean) for loss in losses.values())
    parts = [
        f"{TITLES[arm]} {'more than 200' if count is None else count}"
        for arm, count in seeds_needed(losses).items()
    ]
    pairs = list(dict.fromkeys(loss.pairs for loss in losses.values()))
    seeds = f"{pairs[0]} seeds an arm" if len(pairs) == 1 else f"{min(pairs)} to {max(pairs)} seeds"
    return (
        f"{seeds}. For intervals narrower than a third of the largest difference "
        f"({largest:.2f}) the spread over pairs requires: {', '.join(parts)}."
    )


def floored_text(results: Results) -> str:
    """Losses with returns floored at that of a robot that does not move, as a sentence."""
    losses = differences(results, floor=STILL)
    needed = seeds_needed(losses)
    parts = [
        f"{TITLES[arm]} {_ends(loss)}, {needed[arm] or 'more than 200'} seeds required"
        for arm, loss in losses.items()
    ]
    text = "With returns floored at that of a robot that does not move, as a robot that moves "
    return f"{text}erratically is switched off: {'; '.join(parts)}."


def difference_figure(losses: Mapping[str, Difference]) -> Figure:
    """Loss of each arm with its interval."""
    from sim2real.report.style import ACCENT, INK, MUTED, house_style, new_figure

    with house_style():
        figure = new_figure(70 + 34 * len(losses), "Return lost in reality without each technique")
        axes = figure.subplots()
        for y, loss in enumerate(losses.values()):
            colour = ACCENT if loss.significant else MUTED
            ends = [[min(loss.mean - loss.low, 1e6)], [min(loss.high - loss.mean, 1e6)]]
            if loss.pairs > 1:
                axes.errorbar([loss.mean], [y], xerr=ends, fmt="none", ecolor=colour, lw=1.6)
            axes.plot([loss.mean], [y], "o", color=colour, ms=4)
        axes.axvline(0, color=INK, lw=0.8)
        axes.margins(0.06, 0.2)
        axes.set_yticks(range(len(losses)), [TITLES[arm] for arm in losses])
        axes.invert_yaxis()
        axes.grid(visible=False, axis="y")
        axes.set_xlabel("return of all techniques\nminus that of this arm, in reality")
    return figure


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
    from sim2real.report.style import ACCENT, FAINT, house_style, new_figure

    with house_style():
        figure = new_figure(60 + 46 * len(table), "Return of each arm in simulation and reality")
        axes = figure.subplots()
        for testbed, colour, offset in (("simulation", FAINT, -0.17), ("reality", ACCENT, 0.17)):
            y = np.arange(len(table)) + offset
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


def trajectory_figure(results: Results) -> Figure:
    """Trajectories in reality, one panel per arm."""
    from sim2real.report.style import ACCENT, FAINT, INK, house_style, new_figure

    arms = list(dict.fromkeys(agent["arm"] for agent in results["agents"]))
    with house_style():
        rows = -(-len(arms) // 2)
        figure = new_figure(170 * rows, "Trajectories of the head in reality, by arm")
        panels = figure.subplots(rows, 2, sharex=True, sharey=True, squeeze=False).ravel()
        for axes in panels[len(arms) :]:
            axes.set_visible(False)
        for axes, arm in zip(panels, arms, strict=False):
            for agent in results["agents"]:
                if agent["arm"] != arm:
                    continue
                for n, path in enumerate(agent["reality"]["path"]):
                    path_m = aligned(np.array(path), np.array(results["targets"]["reality"][n]))
                    axes.plot(*path_m.T, color=ACCENT if arm == "all" else INK, lw=0.7, alpha=0.7)
            axes.plot([-1.5], [0], "o", mfc="none", mec=FAINT)
            axes.plot([0], [0], "o", color=INK, markersize=3)
            axes.set(aspect="equal", xlim=(-1.7, 0.6), ylim=(-0.5, 0.5))
            axes.set_title(TITLES[arm])
    return figure


def aligned(path: np.ndarray[Any, Any], target: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """The trajectory with its start at the origin and the target on the negative x axis."""
    direction = target - path[0]
    direction = direction / np.linalg.norm(direction)
    moved = path - path[0]
    return np.stack([-moved @ direction, moved @ np.array([-direction[1], direction[0]])], axis=1)
