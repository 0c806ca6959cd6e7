"""Missing effects in a report: probabilities, reduction of the error, sizes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from sim2real.diagnose.result import Diagnosis, Estimate, NamedEffect
from sim2real.model import JointModel
from sim2real.report.diagnosis_bars import Bar, bar_figure
from sim2real.report.diagnosis_words import listed, per_inertia, plain, sure
from sim2real.report.drawing import svg
from sim2real.report.live_plot import Live
from sim2real.report.page import Block, Figure, Table, Text
from sim2real.report.quantity import milliradians, printable, quantities
from sim2real.report.style import NARROW
from sim2real.units import readable, readable_name

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

_MOVED = 0.01
"""Smallest relative change of a parameter that is shown in a table."""
_SERVO = {"kp_Nm_per_rad": 1.0, "kd_Nms_per_rad": 1.0, "latency_s": 1e3}
"""Parameters of the plain servo, with the scale of their unit in ``quantities``."""
_NOT_LISTED = 0.01
_PROBABILITIES = "Probability of each candidate.{named}{shared}"
_COLOURS = " Coloured: effects named above; grey: other candidates."
_SHARED = " Effects in a bracket share one bar, as these recordings cannot distinguish them."
_LADDER = (
    "Error (root mean square) on held-out recordings or parts of recordings.{named} "
    "No simulation can be below the sensor noise."
)
_WORTH = (
    " The named effects matter where their bar is clearly shorter than that of the plain servo."
)
_PARAMETERS = "Size of each effect, with its 90 % interval below."
_NEGLIGIBLE = (
    "Detectable but negligible: these effects are present as well and hardly change the held-out "
    "error."
)
_SHIFTS = (
    "Bias of the plain fit: without the missing effect, its stiffness (kp), damping (kd) and "
    "latency compensate for it in part. Change of each with the effect, with the values before and "
    "after below."
)


def candidate_figure(diagnosis: Diagnosis) -> Drawing:
    """Probability of each candidate; only the verdict if there is none."""
    bars = _candidates(diagnosis) or [Bar(diagnosis.verdict.replace("_", " "), 0.0, "")]
    return bar_figure({"": bars}, "probability of each candidate", full=1.0)


def what_blocks(diagnosis: Diagnosis) -> list[Block]:
    """Probabilities, held-out errors, sizes, and the bias of the plain fit."""
    blocks: list[Block] = []
    candidates = _candidates(diagnosis)
    if candidates:
        blocks.append(Text(_removed(diagnosis), heading="What is missing"))
        drawing = candidate_figure(diagnosis)
        colours = _COLOURS if diagnosis.effects else ""
        shared = _SHARED if any(bar.members for bar in candidates) else ""
        blocks.append(figure(drawing, _PROBABILITIES.format(named=colours, shared=shared)))
    blocks += _ladders(diagnosis)
    rows = [row for effect in diagnosis.effects for row in _parameter_rows(diagnosis, effect)]
    if rows:
        blocks.append(Table(("effect", "number", "estimate"), rows, _PARAMETERS))
    small = [row for effect in diagnosis.negligible for row in _parameter_rows(diagnosis, effect)]
    if small:
        blocks.append(Table(("effect", "number", "estimate"), small, _NEGLIGIBLE))
    return blocks + _shifts(diagnosis)


def figure(drawing: Drawing, caption: str, live: Live | None = None) -> Figure:
    """A figure of the page, with a narrow version for phones and perhaps one to zoom into."""
    return Figure(svg(drawing), caption, svg(drawing, width=NARROW), live)


def _candidates(diagnosis: Diagnosis) -> list[Bar]:
    named = [_named(effect) for effect in diagnosis.effects]
    unnamed = [(r.probability, f"{r.component}: {plain(r.effect)}") for r in diagnosis.rivals]
    differing = {mismatch.component for mismatch in diagnosis.mismatch}
    unnamed += [
        (probability, f"{joint}: an effect that is not in the catalogue")
        for joint, probability in diagnosis.unknown.items()
        if joint in differing and probability > _NOT_LISTED
    ]
    unnamed.sort(key=lambda row: -row[0])
    named.sort(key=lambda bar: -bar.value)
    return named + [Bar(label, p, sure(p)) for p, label in unnamed]


def _named(effect: NamedEffect) -> Bar:
    p, members = effect.probability, tuple(map(plain, effect.group or (effect.effect,)))
    if len(members) > 1:
        label = f"{effect.component}: one of these"
        return Bar(label, p, sure(p), strong=True, members=members)
    return Bar(f"{effect.component}: {members[0]}", p, sure(p), strong=True)


def _removed(diagnosis: Diagnosis) -> str:
    together: dict[tuple[str, float, float], tuple[list[str], float | None]] = {}
    for effect in diagnosis.effects:
        before, after, share = (
            effect.heldout.get(name)
            for name in ("rmse_before", "rmse_after", "recoverable_removed")
        )
        if before is not None and after is not None:
            names, _ = together.setdefault((effect.component, before, after), ([], share))
            names.append(plain(effect.effect))
    sentences = []
    for (component, before, after), (names, share) in together.items():
        of_it = "" if share is None else f", {100 * share:.0f} % of what can be removed"
        verb = "reduce" if len(names) > 1 else "reduces"
        sentences.append(
            f"On data not used by the fit (but by the selection), {listed(names)} "
            f"({component}) {verb} the error from {milliradians(before)} to "
            f"{milliradians(after)}{of_it}."
        )
    introduction = "Every effect of the catalogue was fitted, alone and in combination with others."
    return " ".join([introduction, *sentences, *_written(diagnosis)])


def _written(diagnosis: Diagnosis) -> list[str]:
    """Sentence on effects of the written model, chosen for prediction, that are not named."""
    named = {name for effect in diagnosis.effects for name in (effect.group or (effect.effect,))}
    unnamed = {
        fitted.effect
        for joint in diagnosis.model.joints.values()
        for fitted in joint.effects
        if fitted.effect not in named
    }
    if not unnamed:
        return []
    kinds = listed([plain(name) for name in sorted(unnamed)])
    return [
        f"The written model was selected for prediction and also contains {kinds}; this does not "
        "imply that they are present."
    ]


def _ladders(diagnosis: Diagnosis) -> list[Block]:
    panels, anything = {}, False
    for signal in (mismatch.signal for mismatch in diagnosis.mismatch):
        plain_fit, enriched = (
            fit.get(signal, {}) for fit in (diagnosis.baseline_fit, diagnosis.enriched_fit)
        )
        joint, noise = signal.rpartition(".")[0], plain_fit.get("noise")
        if noise is None or plain_fit.get("heldout") is None or enriched.get("heldout") is None:
            continue
        has_effects = any(e.component in (joint, "supply", "link") for e in diagnosis.effects)
        anything |= has_effects
        rungs = [
            ("plain servo", plain_fit["heldout"], False),
            ("with the named effects", enriched["heldout"] if has_effects else None, True),
            ("sensor noise", noise, False),
        ]
        panels[joint] = [
            Bar(label, x, milliradians(x), strong) for label, x, strong in rungs if x is not None
        ]
    if not panels:
        return []
    caption = _LADDER.format(named=_WORTH if anything else "")
    return [figure(bar_figure(panels, "held-out error"), caption)]


def _parameter_rows(diagnosis: Diagnosis, effect: NamedEffect) -> list[tuple[str, str, str]]:
    bare = per_inertia(diagnosis, effect.component)
    title = f"{plain(effect.effect)}\n{effect.component}"
    return [
        ("" if k else title, printable(readable_name(name)), _interval(name, estimate, bare))
        for k, (name, estimate) in enumerate(effect.parameters.items())
    ]


def _interval(name: str, estimate: Estimate, bare: bool) -> str:
    value, low, high = (
        readable(name, x, per_inertia=bare) for x in (estimate.mean, estimate.q05, estimate.q95)
    )
    return value if low == high else f"{value}\n{low} – {high}"


def _shifts(diagnosis: Diagnosis) -> list[Block]:
    by_joint: dict[str, Mapping[str, float]] = {}
    for effect in diagnosis.effects:
        joint = _joint(diagnosis, effect)
        if joint is not None:
            by_joint.setdefault(joint, effect.baseline_shift)
    joints = diagnosis.model.joints
    moved = {name: x for name, x in by_joint.items() if _moved(joints[name], x)}
    rows = [(name, *_moves(joints[name], shift)) for name, shift in moved.items()]
    return [Table(("servo", "kp", "kd", "latency"), rows, _SHIFTS)] if rows else []


def _joint(diagnosis: Diagnosis, effect: NamedEffect) -> str | None:
    """The joint that the shift is of; the first one if several share an effect."""
    joints = diagnosis.model.joints
    if effect.component in joints:
        return effect.component
    holders = (n for n, j in joints.items() if effect.effect in {e.effect for e in j.effects})
    return next(holders, None)


def _moved(joint: JointModel, shift: Mapping[str, float]) -> bool:
    values = {name: getattr(joint, name) for name in _SERVO}
    return any(
        abs(shift.get(name, 0.0)) > _MOVED * abs(x - shift.get(name, 0.0))
        for name, x in values.items()
    )


def _moves(joint: JointModel, shift: Mapping[str, float]) -> list[str]:
    """A cell for each parameter of the servo: change in percent, values before and after."""
    cells = []
    for (name, scale), shown in zip(_SERVO.items(), quantities(joint)[:3], strict=True):
        change = scale * shift.get(name, 0.0)
        before = shown.value - change
        percent = f"{100 * change / before:+.0f} %".replace("-", "−") if before > 0 else "–"
        percent = "0 %" if percent in ("+0 %", "−0 %") else percent
        cells.append(f"{percent}\n{before:.3g} to {shown.value:.3g} {shown.unit}")
    return cells
