"""A diagnosis of swims as a section of a page."""

from __future__ import annotations

from collections.abc import Sequence

from sim.inference.law_error import LAW_ERROR
from sim.inference.swims import Swim, SwimSimulator
from sim.view.calibration_plot import comparison_block
from sim2real.diagnose.result import Diagnosis, NamedEffect, Rival, percent
from sim2real.model import Model
from sim2real.report.page import Block, Note, Section, Table, Text
from sim2real.report.quantity import change_text
from sim2real.robot import Robot
from sim2real.units import readable, readable_name

_LEAD = "Which physics of the body or the camera does the simulator leave out of these swims?"
_SENTENCES = {
    "consistent": ("good", "These swims show no missing effect."),
    "explained": ("good", "What was missing from the simulation is identified."),
    "partly_explained": ("info", "A part of what is missing is identified; another part is not."),
    "unexplained": ("info", "Something is missing that no effect of the catalogue explains."),
    "ambiguous": ("info", "Something is missing; these swims do not distinguish its candidates."),
}


_PLOTTED = 3
"""Largest number of swims that are plotted."""


def swims_section(
    diagnosis: Diagnosis, swims: Sequence[Swim], simulate: SwimSimulator | None, robot: Robot
) -> Section:
    """The verdict, the effects with their probabilities, the rivals, and the errors.

    Args:
        diagnosis: The diagnosis.
        swims: Its swims; the first few are plotted if the models differ.
        simulate: Simulator of the search; without plots where None.
        robot: The robot.
    """
    kind, sentence = _SENTENCES[diagnosis.verdict]
    blocks: list[Block] = [Note("good" if kind == "good" else "info", sentence)]
    likely = [e for e in diagnosis.effects if e.probability >= LAW_ERROR.decisions["likely"]]
    if likely:
        rows = [
            (
                e.statement,
                percent(e.probability),
                "; ".join(
                    f"{readable_name(name)} {readable(name, x.mean)} "
                    f"({readable(name, x.q05)} to {readable(name, x.q95)})"
                    for name, x in e.parameters.items()
                ),
            )
            for e in likely
        ]
        header = ("what is missing", "probability", "parameters with 90 % intervals")
        blocks.append(Table(header, rows))
    plain, enriched = (
        {name: float(e["heldout"] or 0.0) for name, e in fit.items()}
        for fit in (diagnosis.baseline_fit, diagnosis.enriched_fit)
    )
    errors = [
        (name, f"{x:.4g}", f"{enriched[name]:.4g}", change_text(x, enriched[name]))
        for name, x in plain.items()
    ]
    caption = "Root mean square error on the end of the swims, fitted to the part before; SI units."
    blocks.append(Table(("signal", "before", "with what is named", ""), errors, caption))
    if simulate is not None and diagnosis.baseline is not None and enriched != plain:
        blocks += [
            _plot(swim, diagnosis.baseline, diagnosis.model, simulate, robot)
            for swim in swims[:_PLOTTED]
        ]
    unlikely = [e for e in diagnosis.effects if e.probability < LAW_ERROR.decisions["likely"]]
    others: list[NamedEffect | Rival] = [*unlikely, *diagnosis.rivals]
    if others:
        considered = [(e.effect, e.component, percent(e.probability)) for e in others]
        blocks.append(Table(("considered as well", "of", "probability"), considered))
    return Section("Diagnosis", _LEAD, [*blocks, *(Text(line) for line in diagnosis.gate)])


def _plot(swim: Swim, before: Model, after: Model, simulate: SwimSimulator, robot: Robot) -> Block:
    caption = "measured, and simulated before and after; both models were fitted to all of it"
    return comparison_block(
        swim, before, after, lambda models, *_: simulate(models, swim), robot,
        f"{swim.name}: {caption}.", label="with what is named", held_out=0.0,
    )  # fmt: skip
