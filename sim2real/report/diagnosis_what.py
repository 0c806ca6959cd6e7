"""What is missing: how likely each candidate is, how much error it takes away, how large it is."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sim2real.diagnose.result import Diagnosis, Estimate, Ladder, NamedEffect
from sim2real.report.drawing import svg
from sim2real.report.page import Block, Figure, Note, Table, Text
from sim2real.report.quantity import milliradians, printable, short_name
from sim2real.report.style import ACCENT, FAINT, INK, MUTED, NARROW, house_style, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Drawing

_COLUMNS = 52
_LINE, _BAR = 17.0, 20.0
_MOVED = 0.01
"""Change of a parameter, as a share of it, from which it is worth a word."""
_UNIT = re.compile(r"_(rad_per_Nm|Nm_per_rad_s|Nm_per_rad|rad_s2|rad_s|rad|Nms2|Nm|kgm2|s)$")
_PROBABILITIES = (
    "How sure we are of each candidate. In colour what is named above, in grey what was considered "
    "as well. Candidates joined by “or” share one bar, as these recordings cannot tell them apart."
)
_LADDER = (
    "Error (root mean square) on recordings, or parts of them, that the fit has not seen. What is "
    "named is worth having where its bar is clearly shorter than that of the plain servo{decoy}. "
    "{floor}No simulation gets below the sensor's noise."
)
_DECOY = " and than that of a decoy, a made-up effect that means nothing"
_FLOOR = "A torque that may be any smooth function of the motion shows how far one could get. "
_PARAMETERS = "How large each effect is; below it the range that holds the truth nine times in ten."


@dataclass(frozen=True)
class Bar:
    """One bar: what it is, how long, the number beside it, and whether it stands out."""

    label: str
    value: float
    text: str
    strong: bool = False


def bar_figure(panels: Mapping[str, Sequence[Bar]], label: str, *, full: float = 0.0) -> Drawing:
    """Draw horizontal bars under their labels, one panel above the other.

    Args:
        panels: The bars by title of the panel.
        label: What a screen reader says.
        full: Length of a full bar; as long as the longest one if that is longer.
    """
    bars = [bar for some in panels.values() for bar in some]
    reach = max([full, *(bar.value for bar in bars)]) or 1.0
    heights = [sum(map(_height, some)) for some in panels.values()]
    with house_style():
        total = sum(heights) + sum(36 if title else 16 for title in panels)
        figure = new_figure(total, printable(label))
        grid = figure.subplots(len(panels), 1, squeeze=False, height_ratios=heights)[:, 0]
        for axes, (title, some) in zip(grid, panels.items(), strict=True):
            _bars(axes, some)
            axes.set_xlim(0, 1.2 * reach)
            axes.set_title(printable(title), color=INK)
    return figure


def _wrapped(bar: Bar) -> list[str]:
    return textwrap.wrap(printable(bar.label), _COLUMNS) or [""]


def _height(bar: Bar) -> float:
    return _LINE * len(_wrapped(bar)) + _BAR


def _bars(axes: Axes, bars: Sequence[Bar]) -> None:
    y = 0.0
    for bar in bars:
        lines = _wrapped(bar)
        axes.text(0, y, "\n".join(lines), va="top", color=INK if bar.strong else MUTED)
        y += _LINE * len(lines) + 4
        colour = ACCENT if bar.strong else FAINT
        axes.barh(y + 2, max(bar.value, 0.0), height=8, color=colour, linewidth=0)
        look: Any = {"xytext": (5, 0), "textcoords": "offset points", "va": "center", "size": 10}
        axes.annotate(bar.text, (max(bar.value, 0.0), y + 2), color=INK, **look)
        y += _BAR - 4
    axes.set_ylim(y, 0)
    axes.grid(visible=False)
    axes.set_xticks([])
    axes.set_yticks([])
    axes.spines["bottom"].set_visible(False)


def what_blocks(diagnosis: Diagnosis) -> list[Block]:
    """Probabilities, held-out errors, sizes, and what the plain fit had hidden."""
    blocks: list[Block] = []
    candidates = _candidates(diagnosis)
    if candidates:
        blocks.append(Text(_removed(diagnosis), heading="What is missing"))
        drawing = bar_figure({"": candidates}, "how sure we are of each candidate", full=1.0)
        blocks.append(figure(drawing, _PROBABILITIES))
    differing = {mismatch.signal for mismatch in diagnosis.mismatch}
    ladders = {name: x for name, x in diagnosis.ladders.items() if name in differing}
    if ladders:
        blocks.append(_ladder_figure(ladders, named=bool(diagnosis.effects)))
    rows = [row for effect in diagnosis.effects for row in _parameter_rows(diagnosis, effect)]
    if rows:
        blocks.append(Table(("effect", "number", "estimate"), rows, _PARAMETERS))
    blocks += [Note("info", sentence) for sentence in _shifts(diagnosis)]
    return blocks


def plain(effect: str) -> str:
    """An effect in plain words."""
    from sim2real.effects import named

    return named(effect).plain


def size(parameter: str, value: float, *, per_inertia: bool) -> str:
    """A parameter's value with its unit; per unit of inertia where the load is not known."""
    from sim2real.effects.effect import readable

    text = readable(parameter, value)
    return text.replace("N m", "N m/(kg m²)") if per_inertia else text


def per_inertia(diagnosis: Diagnosis, component: str) -> bool:
    """Whether the torques of a component are per unit of inertia."""
    joints = diagnosis.model.joints
    some = [joints[component]] if component in joints else list(joints.values())
    return any(joint.per_inertia for joint in some)


def _candidates(diagnosis: Diagnosis) -> list[Bar]:
    rows: list[tuple[float, str, bool]] = [
        (e.probability, f"{e.component}: {' or '.join(map(plain, e.group or (e.effect,)))}", True)
        for e in diagnosis.effects
    ]
    rows += [(r.probability, f"{r.component}: {plain(r.effect)}", False) for r in diagnosis.rivals]
    differing = {mismatch.component for mismatch in diagnosis.mismatch}
    rows += [
        (probability, f"{joint}: something that is not in the catalogue", False)
        for joint, probability in diagnosis.unknown.items()
        if joint in differing and probability > 0.01
    ]
    rows.sort(key=lambda row: (not row[2], -row[0]))
    return [Bar(label, p, sure(p), strong) for p, label, strong in rows]


def sure(share: float) -> str:
    """A probability in percent; never 0 or 100, as nothing is that sure."""
    low, high = "less than 1 %", "more than 99 %"
    return high if share > 0.99 else low if share < 0.01 else f"{100 * share:.0f} %"


def _removed(diagnosis: Diagnosis) -> str:
    sentences = []
    for effect in diagnosis.effects:
        before, after, share = (
            effect.heldout.get(name)
            for name in ("rmse_before", "rmse_after", "recoverable_removed")
        )
        if before is not None and after is not None:
            of_it = "" if share is None else f", {100 * share:.0f} % of what can be removed"
            sentences.append(
                f"On data not used for the fit, {plain(effect.effect)} ({effect.component}) brings "
                f"the error from {milliradians(before)} to {milliradians(after)}{of_it}."
            )
    rate = diagnosis.false_discovery_rate
    if rate > 0:
        sentences.append(f"Tests with decoys put the share of wrong names at {sure(rate)}.")
    every = "Every effect in the catalogue was tried in turn, alone and with others."
    return " ".join([every, *dict.fromkeys(sentences)])


def _ladder_figure(ladders: Mapping[str, Ladder], *, named: bool) -> Figure:
    panels = {signal.partition(".")[0]: _rungs(x, named=named) for signal, x in ladders.items()}
    decoy = any(ladder.best_decoy is not None for ladder in ladders.values())
    floor = any(ladder.black_box is not None for ladder in ladders.values())
    caption = _LADDER.format(decoy=_DECOY if decoy else "", floor=_FLOOR if floor else "")
    return figure(bar_figure(panels, "held-out error of each predictor"), caption)


def _rungs(ladder: Ladder, *, named: bool) -> list[Bar]:
    rungs: list[tuple[str, float | None, bool]] = [
        ("plain servo", ladder.baseline, False),
        ("with the best decoy", ladder.best_decoy, False),
        ("with what is named", ladder.enriched if named else None, True),
        ("with any smooth torque", ladder.black_box, False),
        ("noise of the sensor", ladder.noise, False),
    ]
    return [Bar(label, x, milliradians(x), strong) for label, x, strong in rungs if x is not None]


def _parameter_rows(diagnosis: Diagnosis, effect: NamedEffect) -> list[tuple[str, str, str]]:
    bare = per_inertia(diagnosis, effect.component)
    title = f"{plain(effect.effect)}\n{effect.component}"
    return [
        ("" if k else title, _spoken(name), _interval(name, estimate, bare))
        for k, (name, estimate) in enumerate(effect.parameters.items())
    ]


def _spoken(parameter: str) -> str:
    return "drift" if parameter == "s_per_s" else _UNIT.sub("", parameter).replace("_", " ")


def _interval(name: str, estimate: Estimate, bare: bool) -> str:
    value, low, high = (
        size(name, x, per_inertia=bare) for x in (estimate.mean, estimate.q05, estimate.q95)
    )
    return value if low == high else f"{value}\n{low} – {high}"


def _shifts(diagnosis: Diagnosis) -> list[str]:
    by_joint: dict[str, Mapping[str, float]] = {}
    for effect in diagnosis.effects:
        joint = _joint(diagnosis, effect)
        if joint is not None:
            by_joint.setdefault(joint, effect.baseline_shift)
    return [sentence for joint, x in by_joint.items() if (sentence := _shift(diagnosis, joint, x))]


def _joint(diagnosis: Diagnosis, effect: NamedEffect) -> str | None:
    """The joint whose servo the shift is of: the first one, where several share an effect."""
    joints = diagnosis.model.joints
    if effect.component in joints:
        return effect.component
    holders = (n for n, j in joints.items() if effect.effect in {e.effect for e in j.effects})
    return next(holders, None)


def _shift(diagnosis: Diagnosis, joint: str, shift: Mapping[str, float]) -> str:
    moves = []
    for name, change in shift.items():
        before = getattr(diagnosis.model.joints[joint], name) - change
        if before > 0 and abs(change) > _MOVED * before:
            sign = "+" if change > 0 else "−"
            moves.append(f"{short_name(name)} moves by {sign}{abs(100 * change / before):.0f} %")
    return f"What the plain fit of {joint} had hidden: {', '.join(moves)}." if moves else ""


def figure(drawing: Drawing, caption: str) -> Figure:
    """A drawing on the page, for a screen and for a phone."""
    return Figure(svg(drawing), caption, svg(drawing, width=NARROW))
