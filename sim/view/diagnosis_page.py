"""A diagnosis of swims as a section of a page."""

from __future__ import annotations

from sim2real.diagnose.result import Diagnosis
from sim2real.report.page import Block, Note, Section, Table, Text

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


def swims_section(found: Diagnosis) -> Section:
    """The verdict, what was named and how sure, what else was considered, and the errors."""
    kind, said = _FOUND[found.verdict]
    blocks: list[Block] = [Note("good" if kind == "good" else "info", said)]
    if found.effects:
        rows = [
            (
                one.statement,
                f"{100 * one.probability:.0f} %",
                "; ".join(
                    f"{name} {x.mean:.3g} ({x.q05:.3g} to {x.q95:.3g})"
                    for name, x in one.parameters.items()
                ),
            )
            for one in found.effects
        ]
        header = ("what is missing", "probability", "parameters, SI, with 90 % intervals")
        blocks.append(Table(header, rows))
    rows = [
        (name, f"{before['heldout']:.4g}", f"{found.enriched_fit[name]['heldout']:.4g}")
        for name, before in found.baseline_fit.items()
    ]
    caption = "Root mean square error on what no fit has seen, in SI units."
    blocks.append(Table(("signal", "before", "with what is named"), rows, caption))
    if found.rivals:
        considered = [
            (one.effect, one.component, f"{100 * one.probability:.0f} %") for one in found.rivals
        ]
        blocks.append(Table(("considered as well", "of", "probability"), considered))
    return Section("Diagnosis", _LEAD, [*blocks, *(Text(line) for line in found.gate)])
