"""Figures and phrases of the diagnosis: bars, residuals over time, missing torque."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from sim2real.arrays import Array
from sim2real.diagnose.result import Diagnosis, JointSeries, NamedEffect, percent
from sim2real.report.quantity import printable
from sim2real.report.series import Panel, in_mrad
from sim2real.report.style import ACCENT, FAINT, INK, MUTED, RULE, house_style, new_figure
from sim2real.viewers.scenes import residual_group

if TYPE_CHECKING:
    from matplotlib.figure import Figure

POINTS = 1500
"""Maximum number of points of a cloud."""
_NOT_LISTED = 0.01
_INSIDE = 99.5
_ROW, _TITLE = 38.0, 36.0


@dataclass(frozen=True)
class Bar:
    """One bar.

    Attributes:
        label: Label, above it.
        value: Length.
        text: Number next to it.
        strong: Whether it is highlighted.
    """

    label: str
    value: float
    text: str
    strong: bool = False


def bar_figure(panels: Mapping[str, Sequence[Bar]], label: str, *, full: float = 0.0) -> Figure:
    """Plot horizontal bars with labels above them, in panels below each other.

    A bar with an infinite value ends at the right edge.

    Args:
        panels: The bars by title of the panel.
        label: Text for screen readers.
        full: Minimum length of the axis.
    """
    every = [bar.value for panel in panels.values() for bar in panel if math.isfinite(bar.value)]
    reach = max([full, *every]) or 1.0
    counts = [len(panel) for panel in panels.values()]
    with house_style():
        figure = new_figure(_ROW * sum(counts) + _TITLE * len(counts), printable(label))
        grid = figure.subplots(len(panels), 1, squeeze=False, height_ratios=counts)[:, 0]
        for axes, (title, bars) in zip(grid, panels.items(), strict=True):
            for row, bar in enumerate(bars):
                value = max(bar.value, 0.0) if math.isfinite(bar.value) else reach
                colour, ink = (ACCENT, INK) if bar.strong else (FAINT, MUTED)
                axes.barh(row + 0.7, value, height=0.22, color=colour)
                axes.text(0, row + 0.5, printable(bar.label), color=ink)
                axes.text(
                    value + 0.01 * reach, row + 0.7, bar.text, color=INK, size=10, va="center"
                )
            axes.set(xlim=(0, 1.2 * reach), ylim=(len(bars), 0), xticks=[], yticks=[])
            axes.spines["bottom"].set_visible(False)
            axes.set_title(printable(title), color=INK)
    return figure


def candidate_figure(diagnosis: Diagnosis) -> Figure:
    """Probability of each candidate; only the verdict if there is none."""
    bars = [
        Bar(_label(effect), effect.probability, sure(effect.probability), strong=True)
        for effect in sorted(diagnosis.effects, key=lambda effect: -effect.probability)
    ]
    others = [(r.probability, f"{r.component}: {plain(r.effect)}") for r in diagnosis.rivals]
    differing = {mismatch.component for mismatch in diagnosis.mismatch}
    others += [
        (probability, f"{joint}: an effect that is not in the catalogue")
        for joint, probability in diagnosis.unknown.items()
        if joint in differing and probability > _NOT_LISTED
    ]
    bars += [Bar(label, p, sure(p)) for p, label in sorted(others, key=lambda row: -row[0])]
    bars = bars or [Bar(diagnosis.verdict.replace("_", " "), 0.0, "")]
    return bar_figure({"": bars}, "probability of each candidate", full=1.0)


def _label(effect: NamedEffect) -> str:
    members = list(map(plain, effect.group or (effect.effect,)))
    one = "one of " if len(members) > 1 else ""
    return f"{effect.component}: {one}{listed(members, 'or')}"


def plain(effect: str) -> str:
    """Phrase for an effect within a sentence; its identifier with spaces if it is unknown."""
    from sim2real.effects import plain as phrase  # it starts Warp

    return printable(phrase(effect))


def sure(share: float) -> str:
    """A probability in percent, never rounded to 0 or 100."""
    words = {"<": "less than ", ">": "more than "}
    text = percent(share).replace(" ", "\u00a0")
    return words.get(text[0], "") + text.lstrip("<>")


def listed(names: Sequence[str], last: str = "and") -> str:
    """``"a, b and c"``."""
    return f" {last} ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))


def residual_panels(
    evidence: Sequence[JointSeries],
    noise_rad: float,
    windows_s: Mapping[str, tuple[tuple[float, float], ...]],
    *,
    enriched: bool,
) -> list[Panel]:
    """Residuals of the plain servo and, if asked for, the enriched one; a panel a recording."""
    panels = []
    for series in evidence:
        residual = residual_group(series)
        kept = residual.signals if enriched else {"plain": residual.signals["plain"]}
        group = in_mrad(replace(residual, signals=kept))
        shaded = windows_s.get(series.recording, ())
        panels.append(Panel(group, f"{series.recording}, mrad", shaded, 2e3 * noise_rad))
    return panels


def torque_figure(evidence: Sequence[JointSeries], unit: str) -> Figure:
    """Plot the torque missing from the plain servo against speed and position."""
    speed, position, torque, sd = (
        _joined(evidence, name) for name in ("speed", "position", "torque", "torque_sd")
    )
    drawn = np.flatnonzero(np.isfinite(speed) & np.isfinite(position) & np.isfinite(torque))
    drawn = drawn[:: max(1, drawn.size // POINTS)]
    with house_style():
        figure = new_figure(280, printable(f"{evidence[0].joint}: missing torque"))
        panels = figure.subplots(1, 2, sharey=True)
        states = (("speed, rad/s", speed), ("position, rad", position))
        for axes, (name, x) in zip(panels, states, strict=True):
            if np.isfinite(sd).any():
                width = 2 * float(np.nanmedian(sd))
                axes.axhspan(-width, width, color=RULE, alpha=0.6, linewidth=0, zorder=0)
            for up, colour in ((True, INK), (False, ACCENT)):
                kept = drawn[(speed[drawn] >= 0) == up]
                label = "turning up" if up else "turning down"
                axes.scatter(x[kept], torque[kept], 9, colour, alpha=0.35, lw=0, label=label)
            axes.set_xlabel(name)
        panels[0].set_title(unit)
        if drawn.size:
            reach = 1.3 * float(np.percentile(np.abs(torque[drawn]), _INSIDE)) or 1.0
            panels[0].set_ylim(-reach, reach)
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=2)
    return figure


def _joined(evidence: Sequence[JointSeries], name: str) -> Array:
    return np.concatenate([getattr(series, name) for series in evidence])
