"""Report of the ablation: HTML page, Markdown tables and figures of the same rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, astuple
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from rl.experiments.ablation import ARMS, PAPER, model_of
from rl.experiments.figures import aligned, bar_panels, paths_figure
from rl.experiments.statistics import OUTCOME, bootstrap, differences, seeds_needed
from rl.sac.checkpoint import curves_figure
from rl.sac.plan import Plan
from sim2real.model import Model
from sim2real.output import write_json, write_whole
from sim2real.report.drawing import ACCENT, FAINT, INK, save_png, svg
from sim2real.report.page import Block, Note, Section, Table, Text, write_page
from sim2real.report.page import Figure as Picture
from sim2real.robot import Robot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Results = Mapping[str, Any]

_RETURNS = (
    "Return: rewards discounted as in training. The paper's reward: undiscounted, with its weight "
    "of energy, 0.001. Means with 90 % bootstrap intervals over agents and repeats. Time (s) and "
    "energy (rad²/s²) are those of all turns: a turn that does not arrive counts with the full "
    "duration of the task."
)
_LOSSES = (
    "With all techniques minus each arm, in reality, agents paired by seed: mean and 90 % "
    "interval, positive if the arm is worse. A loss of return is significant if its interval "
    "excludes zero. Needed are the seeds for an interval narrower than a third of the largest loss "
    "of return."
)
_TURNS = "Paths of the head in reality, two of each agent. What lies outside of a panel is cut."
_VALUES = (
    "FishGym (Liu et al., ICRA 2022) drives the joints of its koi by torque of at most 2 N m and "
    "gives all links the density 1080 kg/m³ (github.com/dongfangliu/gym-fish). Here commands are "
    "angles, so its drive is a stiff controller at the same limit, and one density for all links "
    "is that which keeps the robot's mass."
)


def write_report(
    results: Results, plan: Plan, folder: Path, note: Mapping[str, Any], values: Table
) -> None:
    """Write ``index.html``, ``ablation.md``, ``ablation.json``; ``curve.png`` if agents trained.

    ``note`` is the provenance, ``values`` the result of ``default_values``.
    """
    content = {**results, "table": rows(results), "provenance": note}
    for name, figure in (("losses", OUTCOME), ("losses_paper", "paper")):
        content[name] = {arm: asdict(loss) for arm, loss in differences(results, figure).items()}
    write_json(folder / "ablation.json", content)
    write_whole(folder / "ablation.md", markdown(results) + "\n")
    trained: dict[str, list[Path]] = {}
    for agent in results["agents"]:
        for run in (folder / "train").rglob(agent["folder"]):
            if (run / "progress.csv").exists():
                trained.setdefault(ARMS[agent["arm"]].title, []).append(run)
    if trained:  # pretrained agents have no curves
        save_png(curves_figure(trained), folder / "curve.png")
    lead = f"{len(results['agents'])} agents of {plan.steps:,} steps in the {plan.fidelity}"
    footer = footer_of(results, note)
    write_page(folder / "index.html", "Ablation", lead, sections(results, plan, values), footer)


def footer_of(results: Results, note: Mapping[str, Any]) -> dict[str, Any]:
    """Provenance for the footer of a page, with the seeds of the agents and PyTorch's version."""
    seeds = ", ".join(map(str, sorted({agent["seed"] for agent in results["agents"]})))
    versions = {**note.get("versions", {}), "torch": torch.__version__}
    return {**note, "seed": f"{note['seed']} (turns), {seeds} (agents)", "versions": versions}


def default_values(model: Model, robot: Robot) -> Table:
    """The values of the model with and without each technique."""

    def column(name: str) -> list[str]:
        one = model_of(ARMS[name], model, robot)
        joints, attributes = one.joints.values(), ("kp_Nm_per_rad", "kd_Nms_per_rad", "latency_s")
        values = [[getattr(joint, attribute) for joint in joints] for attribute in attributes]
        effects = [effect for joint in joints for effect in joint.effects]
        limits = [e.parameters["limit_Nm"] for e in effects if e.effect == "torque_saturation"]
        values += [limits, one.body["normalised_density"]]
        return [", ".join(f"{x:.3g}" for x in (v if len(set(v)) > 1 else v[:1])) for v in values]

    names = ("servo kp (N m/rad)", "servo kd (N m s/rad)", "servo latency (s)",
             "servo torque limit (N m)", "normalised density of the links")  # fmt: skip
    lines = [
        (x, a or "none", b) for x, a, b in zip(names, column("full"), column("none"), strict=True)
    ]
    lines.append(("robot of an episode", "from the ranges, with noise", "this one, without noise"))
    return Table(("parameter", "with the technique", "without it"), lines, _VALUES)


def rows(results: Results) -> list[dict[str, Any]]:
    """One row per arm: by testbed, means, and 90 % intervals except of the share that arrives."""
    out = []
    for arm in dict.fromkeys(agent["arm"] for agent in results["agents"]):
        agents = [agent for agent in results["agents"] if agent["arm"] == arm]
        row: dict[str, Any] = {"arm": arm}
        for testbed in results["testbeds"]:
            one: dict[str, Any] = {}
            row[testbed] = one
            for name in (OUTCOME, "paper", "success", "time_s", "energy"):
                values = [agent[testbed][name] for agent in agents]
                one[name] = bootstrap(values, np.random.default_rng(0))
            for name in ("success", "time_s", "energy"):
                one[name], *one[f"{name}_interval"] = one[name]
        out.append(row)
    return out


def tables(results: Results) -> dict[str, Table]:
    """The tables of the report: ``returns`` and ``losses``."""
    table, returns = rows(results), []
    for row in table:
        for testbed in results["testbeds"]:
            one = row[testbed]
            time, used = ((one[x], *one[f"{x}_interval"]) for x in ("time_s", "energy"))
            returns.append((
                f"{ARMS[row['arm']].title}\n{testbed}", _ends(one[OUTCOME]),
                _ends(one["paper"], ".1f"), f"{100 * one['success']:.0f} %",
                _ends(time, ".1f"), _ends(used, ",.0f"),
            ))  # fmt: skip
    header = ("arm", "return", "paper's reward", "arrives", "time (s)", "energy")
    losses, by_paper = differences(results), differences(results, "paper")
    needed = {arm: S or "more than 200" for arm, S in seeds_needed(losses).items()}
    lost = [
        (ARMS[arm].title, _ends((x.mean, x.low, x.high), "+.2f"), "yes" if x.significant else "no",
         f"{x.sd:.2f}", str(x.pairs), str(needed[arm]), _ends(astuple(by_paper[arm])[:3], "+.1f"))
        for arm, x in losses.items()
    ]  # fmt: skip
    titles = ("arm", "loses return, by seed", "significant", "sd over pairs", "pairs", "needed",
              "loses paper's reward")  # fmt: skip
    return {"returns": Table(header, returns, _RETURNS), "losses": Table(titles, lost, _LOSSES)}


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


def sections(results: Results, plan: Plan, values: Table) -> list[Section]:
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
        f"Each agent: {plan.steps:,} steps of soft actor-critic at the task “{plan.task.name}”, "
        f"{plan.envs} environments, {plan.settings.updates_per_step:g} updates a step, energy "
        f"weight {plan.task.energy:g}; {results['repeats']} turns each in simulation and in "
        f"reality. Simulation: {results['said']['simulation']}. "
        f"Reality: {results['said']['reality']}."
    )
    effect: list[Block] = [Picture(svg(return_figure(table)), "Intervals as in the table.")]
    effect += [made["returns"], Text(order_text(table)), values]
    kept = retention_text({row["arm"]: row for row in table})
    return [
        Section("Effect of each technique", kept, effect),
        Section("Loss without each technique", "", lost),
        Section("The turns", "", [Picture(svg(trajectory_figure(results)), _TURNS)]),
        Section("Method", "", [method]),
    ]


def retention_text(by_arm: Mapping[str, Mapping[str, Any]]) -> str:
    """The share of its simulated return that arm "full" keeps in reality, as a sentence."""
    if "full" not in by_arm:
        return ""
    (sim, low, _), (real, *_) = (by_arm["full"][x][OUTCOME] for x in ("simulation", "reality"))
    text = f"With all techniques the return is {sim:.2f} in simulation and {real:.2f} in reality"
    text += f", {100 * real / sim:.0f} % of it." if low > 0 else "."
    if "full-and-effects" in by_arm and sim > real:
        gain = by_arm["full-and-effects"]["reality"][OUTCOME][0] - real
        text += f" With the effects found, {100 * gain / (sim - real):.0f} % of the gap is closed."
    return text


def order_text(table: list[dict[str, Any]]) -> str:
    """The order of the arms in reality by both measures, beside the paper's; why they differ."""
    real = {row["arm"]: row["reality"] for row in table}
    measures = {"return": OUTCOME, "the paper's reward": "paper"}
    orders = {x: sorted(real, key=lambda arm: -real[arm][key][0]) for x, key in measures.items()}
    listed = (
        f"By {name}: " + ", ".join(f"{ARMS[x].title} ({real[x][key][0]:.1f})" for x in orders[name])
        for name, key in measures.items()
    )
    texts = [f"In reality. {'. '.join(listed)}."]
    if set(PAPER) <= real.keys():
        four = {name: [arm for arm in order if arm in PAPER] for name, order in orders.items()}
        held = [name for name, o in four.items() if (o[0], o[-1]) == ("full", "no-servo")]
        texts.append(
            "The paper's order, all techniques first and no servo calibration last, is found by "
            f"{' and by '.join(held) or 'neither measure'}."
        )
    first = real.get("full", {})
    for arm, one in real.items() if first else ():
        value, paper = (one[key][0] - first[key][0] for key in measures.values())
        if value * paper < 0:
            saved, later = first["energy"] - one["energy"], one["time_s"] - first["time_s"]
            texts.append(
                f"The measures disagree on {ARMS[arm].title}: against all techniques it has "
                f"{paper:+.1f} of the paper's reward, {0.001 * saved:+.1f} of it by its energy "
                f"({one['energy']:.0f} instead of {first['energy']:.0f}), with turns "
                f"{abs(later):.1f} s {'longer' if later > 0 else 'shorter'}. The paper's reward "
                "has no price of time: an arm that beats slowly scores by spending less."
            )
    return " ".join(texts)


def return_figure(table: list[dict[str, Any]]) -> Figure:
    """Return and the paper's reward of each arm in simulation and in reality, with intervals."""
    measures = {"discounted return of a 180° turn": OUTCOME, "the paper's reward": "paper"}
    panels = {
        label: [
            (testbed, colour, np.array([row[testbed][name] for row in table]).T)
            for testbed, colour in (("simulation", FAINT), ("reality", ACCENT))
        ]
        for label, name in measures.items()
    }
    return bar_panels("Two measures of each arm", [ARMS[row["arm"]].title for row in table], panels)


def trajectory_figure(results: Results) -> Figure:
    """Trajectories in reality, one panel per arm, that of all techniques highlighted."""
    targets = np.array(results["targets"]["reality"])
    ways: dict[str, list[Any]] = {}
    for agent in results["agents"]:
        colour = ACCENT if agent["arm"] == "full" else INK
        ways.setdefault(ARMS[agent["arm"]].title, []).extend(
            aligned(np.array(path), target, colour)
            for path, target in zip(agent["reality"]["path"], targets, strict=False)
        )
    label, limits = "Trajectories of the head in reality, by arm", ((-1.7, 0.6), (-0.5, 0.5))
    return paths_figure(ways, label, away_m=[1.5], limits=limits)
