"""What is missing: how likely each candidate is, how much error it takes away, how large it is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from sim2real.diagnose.result import Diagnosis, Estimate, Ladder, NamedEffect
from sim2real.model import JointModel
from sim2real.report.diagnosis_bars import Bar, bar_figure
from sim2real.report.diagnosis_words import listed, per_inertia, plain, sure
from sim2real.report.drawing import svg
from sim2real.report.page import Block, Figure, Table, Text
from sim2real.report.quantity import milliradians, printable, quantities
from sim2real.report.style import NARROW
from sim2real.units import readable, readable_name

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

_MOVED = 0.01
"""Change of a parameter, as a share of it, from which it is worth a table."""
_SERVO = {"kp_Nm_per_rad": 1.0, "kd_Nms_per_rad": 1.0, "latency_s": 1e3}
"""Parameters of the plain servo, with the size of the unit that ``quantities`` shows them in."""
_NOT_LISTED = 0.01
_PROBABILITIES = "How sure we are of each candidate.{named}{shared}"
_COLOURS = " In colour what is named above, in grey what was considered as well."
_SHARED = " What stands in a bracket shares one bar, as these recordings cannot tell it apart."
_LADDER = (
    "Error (root mean square) on recordings, or parts of them, that the fit has not seen.{named} "
    "No simulation gets below the sensor's noise."
)
_WORTH = (
    " What is named is worth having where its bar is clearly shorter than that of the plain servo."
)
_PARAMETERS = "How large each effect is; below it the range that holds the truth nine times in ten."
_NEGLIGIBLE = (
    "Detectable, negligible: these are there, too, and hardly change the error on what the fit has "
    "not seen."
)
_SHIFTS = (
    "What the plain fit had been hiding: without the missing effect, its stiffness (kp), damping "
    "(kd) and latency were bent to make up for it. How far each moved once the effect was there, "
    "and below it the values before and after."
)


def candidate_figure(diagnosis: Diagnosis) -> Drawing:
    """How sure we are of each candidate; the verdict alone where there is none."""
    bars = _candidates(diagnosis) or [Bar(diagnosis.verdict.replace("_", " "), 0.0, "")]
    return bar_figure({"": bars}, "how sure we are of each candidate", full=1.0)


def what_blocks(diagnosis: Diagnosis) -> list[Block]:
    """Probabilities, held-out errors, sizes, and what the plain fit had been hiding."""
    blocks: list[Block] = []
    candidates = _candidates(diagnosis)
    if candidates:
        blocks.append(Text(_removed(diagnosis), heading="What is missing"))
        drawing = candidate_figure(diagnosis)
        named = _COLOURS if diagnosis.effects else ""
        shared = _SHARED if any(bar.members for bar in candidates) else ""
        blocks.append(figure(drawing, _PROBABILITIES.format(named=named, shared=shared)))
    blocks += _ladders(diagnosis)
    rows = [row for effect in diagnosis.effects for row in _parameter_rows(diagnosis, effect)]
    if rows:
        blocks.append(Table(("effect", "number", "estimate"), rows, _PARAMETERS))
    small = [row for effect in diagnosis.negligible for row in _parameter_rows(diagnosis, effect)]
    if small:
        blocks.append(Table(("effect", "number", "estimate"), small, _NEGLIGIBLE))
    return blocks + _shifts(diagnosis)


def figure(drawing: Drawing, caption: str) -> Figure:
    """A drawing on the page, for a screen and for a phone."""
    return Figure(svg(drawing), caption, svg(drawing, width=NARROW))


def _candidates(diagnosis: Diagnosis) -> list[Bar]:
    named = [_named(effect) for effect in diagnosis.effects]
    others = [(r.probability, f"{r.component}: {plain(r.effect)}") for r in diagnosis.rivals]
    differing = {mismatch.component for mismatch in diagnosis.mismatch}
    others += [
        (probability, f"{joint}: something that is not in the catalogue")
        for joint, probability in diagnosis.unknown.items()
        if joint in differing and probability > _NOT_LISTED
    ]
    others.sort(key=lambda row: -row[0])
    named.sort(key=lambda bar: -bar.value)
    return named + [Bar(label, p, sure(p)) for p, label in others]


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
        verb = "bring" if len(names) > 1 else "brings"
        sentences.append(
            f"On what was left out of the fit (though not out of the choice), {listed(names)} "
            f"({component}) {verb} the error from {milliradians(before)} to "
            f"{milliradians(after)}{of_it}."
        )
    every = "Every effect in the catalogue was tried in turn, alone and with others."
    return " ".join([every, *sentences, *_written(diagnosis)])


def _written(diagnosis: Diagnosis) -> list[str]:
    """What the written model holds besides the names, which it may, as it is to predict."""
    named = {name for effect in diagnosis.effects for name in (effect.group or (effect.effect,))}
    more = {
        fitted.effect
        for joint in diagnosis.model.joints.values()
        for fitted in joint.effects
        if fitted.effect not in named
    }
    if not more:
        return []
    kinds = listed([plain(name) for name in sorted(more)])
    return [
        f"The model that is written was chosen to predict best and holds {kinds} as well; that is "
        "no claim that they are there."
    ]


def _ladders(diagnosis: Diagnosis) -> list[Block]:
    differing = {mismatch.signal for mismatch in diagnosis.mismatch}
    ladders = {name: x for name, x in diagnosis.ladders.items() if name in differing}
    if not ladders:
        return []
    panels, anything = {}, False
    for signal, ladder in ladders.items():
        joint = signal.rpartition(".")[0]
        named = any(e.component in (joint, "supply", "link") for e in diagnosis.effects)
        anything |= named
        panels[joint] = _rungs(ladder, named=named)
    caption = _LADDER.format(named=_WORTH if anything else "")
    return [figure(bar_figure(panels, "held-out error"), caption)]


def _rungs(ladder: Ladder, *, named: bool) -> list[Bar]:
    rungs: list[tuple[str, float | None, bool]] = [
        ("plain servo", ladder.baseline, False),
        ("with what is named", ladder.enriched if named else None, True),
        ("noise of the sensor", ladder.noise, False),
    ]
    return [Bar(label, x, milliradians(x), strong) for label, x, strong in rungs if x is not None]


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
    """The joint whose servo the shift is of: the first one, where several share an effect."""
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
    """A cell for each parameter of the servo: change in percent; before and after."""
    cells = []
    for (name, scale), shown in zip(_SERVO.items(), quantities(joint)[:3], strict=True):
        change = scale * shift.get(name, 0.0)
        before = shown.value - change
        percent = f"{100 * change / before:+.0f} %".replace("-", "−") if before > 0 else "–"
        percent = "0 %" if percent in ("+0 %", "−0 %") else percent
        cells.append(f"{percent}\n{before:.3g} to {shown.value:.3g} {shown.unit}")
    return cells
