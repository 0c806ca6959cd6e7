"""Figures and phrases of the diagnosis: bars, residuals over time, missing torque."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from sim2real.diagnose.result import Diagnosis, JointSeries, percent
from sim2real.display import Drawing
from sim2real.report.drawing import ACCENT, FAINT, INK, MUTED, RULE, new_figure
from sim2real.report.page import printable
from sim2real.report.series import Panel, in_mrad
from sim2real.viewers.scenes import residual_group

POINTS = 1500
"""Maximum number of points of a cloud."""
_NOT_LISTED = 0.01
_INSIDE = 99.5
_ROW, _TITLE = 38.0, 36.0


def bar_figure(rows: Sequence[tuple[float, str, bool]]) -> Drawing:
    """Plot probabilities as bars with labels above them, some of them highlighted."""
    with new_figure(_ROW * len(rows) + _TITLE, "probability of each candidate") as figure:
        axes = figure.subplots()
        for row, (share, label, strong) in enumerate(rows):
            colour, ink = (ACCENT, INK) if strong else (FAINT, MUTED)
            axes.barh(row + 0.7, share, height=0.22, color=colour)
            axes.text(0, row + 0.5, printable(label), color=ink)
            text = sure(share) if share else ""
            axes.text(share + 0.01, row + 0.7, text, color=INK, size=10, va="center")
        axes.set(xlim=(0, 1.2), ylim=(len(rows), 0), xticks=[], yticks=[], title=" ")
        axes.spines["bottom"].set_visible(False)
    return figure


def candidate_figure(diagnosis: Diagnosis) -> Drawing:
    """Probability of each candidate; only the verdict if there is none."""
    named = []
    for effect in diagnosis.effects:
        members = list(map(plain, effect.group or (effect.effect,)))
        one = "one of " if len(members) > 1 else ""
        label = f"{effect.component}: {one}{listed(members, 'or')}"
        named.append((effect.probability, label, True))
    others = [(r.probability, f"{r.component}: {plain(r.effect)}", False) for r in diagnosis.rivals]
    differing = {mismatch.component for mismatch in diagnosis.mismatch}
    others += [
        (probability, f"{joint}: an effect that is not in the catalogue", False)
        for joint, probability in diagnosis.unknown.items()
        if joint in differing and probability > _NOT_LISTED
    ]
    rows = [row for some in (named, others) for row in sorted(some, key=lambda row: -row[0])]
    return bar_figure(rows or [(0.0, diagnosis.verdict.replace("_", " "), False)])


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


def torque_figure(evidence: Sequence[JointSeries], unit: str) -> Drawing:
    """Plot the torque missing from the plain servo against speed and position."""
    names = ("speed", "position", "torque", "torque_sd")
    parts = ([getattr(series, name) for series in evidence] for name in names)
    speed, position, torque, sd = map(np.concatenate, parts)
    drawn = np.flatnonzero(np.isfinite(speed) & np.isfinite(position) & np.isfinite(torque))
    drawn = drawn[:: max(1, drawn.size // POINTS)]
    with new_figure(280, printable(f"{evidence[0].joint}: missing torque")) as figure:
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
