"""Export of randomization ranges to other simulators: functions common to all targets."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

from sim2real.effects import CATALOGUE
from sim2real.exporters.actuator import MOTOR_TERMS, LeftOut
from sim2real.ranges.entry import Range, Ranges

_EFFECTS = {effect.name for effect in CATALOGUE}

SHARED = "robot"
"""Used instead of a joint for ranges of all joints, the supply or the link."""

REASONS = {
    "motor": "nothing there draws limits or losses of a motor; set them when the actuator is made",
    "torque_saturation": "nothing there draws the limit of an actuator; set it when it is made",
    "normalised_density": "relative to the robot's mean density: scale the masses of its links",
    "position_noise_m": "noise of a camera: add it to the observation of the body's position",
    "yaw_noise_rad": "noise of a camera: add it to the observation of the heading",
}


@dataclass(frozen=True)
class Term:
    """A range and its quantity.

    Attributes:
        joint: The joint's name, ``body`` or ``robot``.
        quantity: ``kp_Nm_per_rad``, ``EFFECT.PARAMETER`` and so on.
        range: The range.
    """

    joint: str
    quantity: str
    range: Range

    @property
    def ends(self) -> str:
        """The two numbers as Python text."""
        return f"({self.range.first!r}, {self.range.second!r})"

    def left_out(self, target: str) -> LeftOut:
        """The line of a quantity that a target lacks."""
        kind = self.quantity.partition(".")[0]
        why = REASONS.get(kind, f"{target} has no such parameter")
        numbers = f"{self.range.distribution} {self.range.first:.6g}, {self.range.second:.6g}"
        return LeftOut(self.joint, f"{self.quantity} ({numbers} {self.range.unit})".rstrip(), why)


def terms(ranges: Ranges) -> list[Term]:
    """The entries of the ranges, each with its joint and quantity.

    Friction and rotor of a motor are those of the effects, unless the joint has these as well.
    """
    found = [_term(entry) for entry in ranges.entries]
    taken = {(term.joint, term.quantity) for term in found}
    names = {f"motor.{key}": f"{effect}.{name}" for key, effect, name in MOTOR_TERMS}
    return [
        replace(term, quantity=names[term.quantity])
        if term.quantity in names and (term.joint, names[term.quantity]) not in taken
        else term
        for term in found
    ]


def _term(entry: Range) -> Term:
    head, dot, tail = entry.parameter.partition(".")
    if not dot or head in _EFFECTS:
        return Term(SHARED, entry.parameter, entry)
    before, _, parameter = entry.parameter.rpartition(".")
    joint, _, effect = before.rpartition(".")
    if head != "body" and effect in {*_EFFECTS, "motor"}:
        return Term(joint, f"{effect}.{parameter}", entry)
    if head == "body":
        return Term(head, tail, entry)
    return Term(before, parameter, entry)


def split(all_terms: list[Term], quantities: Collection[str]) -> tuple[list[Term], list[Term]]:
    """The terms that a target draws once per episode, and the remaining ones.

    Latency and the noise of joints are in neither: see `delays` and `noise_sds`.
    """
    drawn = [t for t in all_terms if t.quantity in quantities and t.range.period == "episode"]
    separate = {t.range.parameter for t in all_terms if _delay(t) or _noise(t)}
    used = separate | {term.range.parameter for term in drawn}
    return drawn, [term for term in all_terms if term.range.parameter not in used]


def delays(all_terms: list[Term]) -> tuple[dict[str, str], list[LeftOut]]:
    """Range of each joint's delay in s as Python text, and parts of it that are not drawn."""
    latency = next((term for term in all_terms if term.quantity == "command_latency_s"), None)
    names = dict.fromkeys(t.joint for t in all_terms if t.joint not in (SHARED, "body"))
    if latency is None:
        return {}, []
    if not names:
        return {}, [LeftOut(SHARED, latency.quantity, "the ranges name no joint to delay")]
    lines, low, high = [], latency.range.first, latency.range.second
    if latency.range.distribution == "normal":
        low, high = low - 2 * high, low + 2 * high
        why = "drawn from a uniform distribution within two standard deviations"
        lines.append(LeftOut(SHARED, "shape of command_latency_s", why))
    texts = {}
    for joint in names:
        offsets = (t for t in all_terms if (t.joint, t.quantity) == (joint, "latency_offset_s"))
        offset = next((term.range for term in offsets), None)
        mean = 0.0
        if offset is not None:
            normal = offset.distribution == "normal"
            mean = offset.first if normal else (offset.first + offset.second) / 2
            why = "only its mean is added to the joint's delay"
            lines.append(LeftOut(joint, "spread of latency_offset_s", why))
        texts[joint] = f"({max(low + mean, 0.0)!r}, {max(high + mean, 0.0)!r})"
    return texts, lines


def noise_sds(all_terms: list[Term]) -> dict[str, str]:
    """Standard deviation of each joint's measured angle in rad, as Python text."""
    return {term.joint: repr(term.range.second) for term in all_terms if _noise(term)}


def _delay(term: Term) -> bool:
    return term.quantity in ("command_latency_s", "latency_offset_s")


def _noise(term: Term) -> bool:
    drawn = term.range
    zero_mean = drawn.distribution == "normal" and drawn.first == 0 and drawn.period == "step"
    return term.quantity == "position_noise_rad" and zero_mean


def table(name: str, comment: str, values: dict[str, str]) -> str:
    """A dictionary by joint as Python text; an empty string without values."""
    if not values:
        return ""
    rows = "".join(f"    {joint!r}: {value},\n" for joint, value in values.items())
    return f"{name} = {{  # {comment}\n{rows}}}\n\n"
