"""Randomization ranges for other simulators: what all of them need to know of an entry."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from sim2real.effects import CATALOGUE
from sim2real.exporters.actuator import LeftOut
from sim2real.ranges.entry import Range, Ranges

_EFFECTS = {effect.name for effect in CATALOGUE}

SHARED = "robot"
"""Stands in for a joint where a range belongs to all of them, the supply or the link."""

REASONS = {
    "normalised_density": "relative to the robot's mean density: scale the masses of its links",
    "position_noise_m": "noise of a camera: add it to the observation of the body's position",
    "yaw_noise_rad": "noise of a camera: add it to the observation of the heading",
}


@dataclass(frozen=True)
class Term:
    """One range and what it is a range of.

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
        """The line that says that a target lacks it."""
        kind = self.quantity.partition(".")[0]
        why = REASONS.get(kind, f"{target} has no such parameter")
        numbers = f"{self.range.distribution} {self.range.first:.6g}, {self.range.second:.6g}"
        return LeftOut(self.joint, f"{self.quantity} ({numbers} {self.range.unit})".rstrip(), why)


def terms(ranges: Ranges) -> list[Term]:
    """The entries of the ranges, each with its joint and quantity."""
    return [_term(entry) for entry in ranges.entries]


def _term(entry: Range) -> Term:
    head, dot, tail = entry.parameter.partition(".")
    if not dot or head in _EFFECTS:
        return Term(SHARED, entry.parameter, entry)
    before, _, last = entry.parameter.rpartition(".")
    joint, _, effect = before.rpartition(".")
    if head != "body" and effect in _EFFECTS:
        return Term(joint, f"{effect}.{last}", entry)
    if head == "body":
        return Term(head, tail, entry)
    return Term(before, last, entry)


def split(found: list[Term], quantities: Collection[str]) -> tuple[list[Term], list[Term]]:
    """The terms that a target draws once an episode, by quantity, and those left over.

    Latency and the noise of joints are in neither: see `delays` and `noises`.
    """
    drawn = [t for t in found if t.quantity in quantities and t.range.period == "episode"]
    elsewhere = {t.range.parameter for t in found if _delay(t) or _noise(t)}
    known = elsewhere | {term.range.parameter for term in drawn}
    return drawn, [term for term in found if term.range.parameter not in known]


def delays(found: list[Term]) -> tuple[dict[str, str], list[LeftOut]]:
    """Ends of each joint's delay in s as Python text, and what of it is not drawn."""
    latency = next((term for term in found if term.quantity == "command_latency_s"), None)
    names = dict.fromkeys(t.joint for t in found if t.joint not in (SHARED, "body"))
    if latency is None:
        return {}, []
    if not names:
        return {}, [LeftOut(SHARED, latency.quantity, "the ranges name no joint to delay")]
    lines, low, high = [], latency.range.first, latency.range.second
    if latency.range.distribution == "normal":
        low, high = low - 2 * high, low + 2 * high
        why = "drawn evenly within two standard deviations"
        lines.append(LeftOut(SHARED, "shape of command_latency_s", why))
    texts = {}
    for joint in names:
        mine = (t for t in found if (t.joint, t.quantity) == (joint, "latency_offset_s"))
        offset = next((term.range for term in mine), None)
        mean = 0.0
        if offset is not None:
            normal = offset.distribution == "normal"
            mean = offset.first if normal else (offset.first + offset.second) / 2
            why = "the joint's delay is moved by its mean"
            lines.append(LeftOut(joint, "spread of latency_offset_s", why))
        texts[joint] = f"({max(low + mean, 0.0)!r}, {max(high + mean, 0.0)!r})"
    return texts, lines


def noises(found: list[Term]) -> dict[str, str]:
    """Standard deviation of each joint's measured angle in rad, as Python text."""
    return {term.joint: repr(term.range.second) for term in found if _noise(term)}


def _delay(term: Term) -> bool:
    return term.quantity in ("command_latency_s", "latency_offset_s")


def _noise(term: Term) -> bool:
    drawn = term.range
    plain = drawn.distribution == "normal" and drawn.first == 0 and drawn.period == "step"
    return term.quantity == "position_noise_rad" and plain


def table(name: str, comment: str, values: dict[str, str]) -> str:
    """A dictionary by joint as Python text; empty where there is nothing in it."""
    if not values:
        return ""
    rows = "".join(f"    {joint!r}: {value},\n" for joint, value in values.items())
    return f"{name} = {{  # {comment}\n{rows}}}\n\n"
