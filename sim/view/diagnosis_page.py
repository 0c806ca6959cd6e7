"""A diagnosis of swims as a section of a page."""

from __future__ import annotations

from collections.abc import Sequence

from sim.inference.coordinates import Swum
from sim.inference.law_error import LAW_ERROR
from sim.inference.swims import Swim
from sim.view.calibration_plot import comparison
from sim2real.diagnose.result import Diagnosis, NamedEffect, Rival, percent
from sim2real.model import Model
from sim2real.report.drawing import svg
from sim2real.report.page import Block, Figure, Note, Section, Table, Text
from sim2real.report.quantity import change_text
from sim2real.report.style import NARROW
from sim2real.robot import Robot
from sim2real.units import readable, readable_name

_LEAD = "Which physics of the body or the camera does the simulator leave out of these swims?"
_FOUND = {
    "consistent": ("good", "Nothing is missing that these swims could show."),
    "explained": ("good", "Something was missing from the simulation, and it has a name now."),
    "partly_explained": (
        "info",
        "A part of what is missing has a name; something else is there that has none.",
    ),
    "unexplained": (
        "info",
        "Something is missing, and nothing in the catalogue accounts for it.",
    ),
    "ambiguous": ("info", "Something is missing; these swims do not tell which of a few it is."),
}


_DRAWN = 3
"""Swims that are drawn at most."""


def swims_section(
    found: Diagnosis, swims: Sequence[Swim], simulate: Swum | None, robot: Robot
) -> Section:
    """The verdict, what was named and how sure, what else was considered, and the errors.

    Args:
        found: The diagnosis.
        swims: What it is of; the first few are drawn where the simulator became another.
        simulate: What simulated them in the search; nothing is drawn where None.
        robot: The robot.
    """
    kind, said = _FOUND[found.verdict]
    blocks: list[Block] = [Note("good" if kind == "good" else "info", said)]
    likely = [one for one in found.effects if one.probability >= LAW_ERROR.decisions["likely"]]
    if likely:
        rows = [
            (
                one.statement,
                percent(one.probability),
                "; ".join(
                    f"{readable_name(name)} {readable(name, x.mean)} "
                    f"({readable(name, x.q05)} to {readable(name, x.q95)})"
                    for name, x in one.parameters.items()
                ),
            )
            for one in likely
        ]
        header = ("what is missing", "probability", "parameters with 90 % intervals")
        blocks.append(Table(header, rows))
    was, now = (
        {name: float(one["heldout"] or 0.0) for name, one in fit.items()}
        for fit in (found.baseline_fit, found.enriched_fit)
    )
    errors = [
        (name, f"{x:.4g}", f"{now[name]:.4g}", change_text(x, now[name])) for name, x in was.items()
    ]
    caption = "Root mean square error at the end of the swims, fitted to what is before; SI units."
    blocks.append(Table(("signal", "before", "with what is named", ""), errors, caption))
    if simulate is not None and found.baseline is not None and now != was:
        blocks += [
            _drawn(swim, found.baseline, found.model, simulate, robot) for swim in swims[:_DRAWN]
        ]
    unlikely = [one for one in found.effects if one.probability < LAW_ERROR.decisions["likely"]]
    others: list[NamedEffect | Rival] = [*unlikely, *found.rivals]
    if others:
        considered = [(one.effect, one.component, percent(one.probability)) for one in others]
        blocks.append(Table(("considered as well", "of", "probability"), considered))
    return Section("Diagnosis", _LEAD, [*blocks, *(Text(line) for line in found.gate)])


def _drawn(swim: Swim, before: Model, after: Model, simulate: Swum, robot: Robot) -> Figure:
    figure = comparison(
        swim, before, after, lambda models, *_: simulate(models, swim), robot,
        label="with what is named", held_out=0.0,
    )  # fmt: skip
    said = "measured, and simulated before and after; both models were fitted to all of it"
    return Figure(svg(figure), f"{swim.name}: {said}.", svg(figure, width=NARROW))
