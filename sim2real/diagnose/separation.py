"""What a designed recording was expected to tell of rival sets of effects, and what it told."""

from __future__ import annotations

from dataclasses import dataclass

from sim2real.effects import plain

SEPARATED = 0.9
"""Probability from which one of two sets of effects is told from the other."""


def in_words(effects: tuple[str, ...], other: tuple[str, ...] = ()) -> str:
    """The effects of a set that another set lacks."""
    return " and ".join(plain(effect) for effect in effects if effect not in other)


def task(first: tuple[str, ...], second: tuple[str, ...]) -> str:
    """What telling two sets apart means, as a clause without a subject."""
    here, there = in_words(first, second), in_words(second, first)
    if here and there:
        return f"separate {here} from {there}"
    return f"show whether there is {here or there}"


@dataclass(frozen=True)
class Separation:
    """Two sets of effects that a recording was to tell apart.

    Attributes:
        component: The joint.
        first: Effects of one set.
        second: Effects of the other.
        expected: Expected probability that the evidence favours the true one of both.
        found: Probability of the more probable one, given that one of them is there; None if the
            recordings rule out both.
        favoured: Effects of that one.
    """

    component: str
    first: tuple[str, ...]
    second: tuple[str, ...]
    expected: float
    found: float | None
    favoured: tuple[str, ...]

    def __str__(self) -> str:
        """What was expected, and what was found, in one sentence."""
        stated = f"{self.component}: expected to {task(self.first, self.second)}"
        stated += f" with {self.expected:.2f}"
        if self.found is None:
            return f"{stated}; both are ruled out."
        if self.found < SEPARATED:
            return f"{stated}; still open, {self.found:.2f}."
        other = self.second if self.favoured == self.first else self.first
        there = in_words(self.favoured, other) or "no " + in_words(other, self.favoured)
        return f"{stated}; found {there}, {self.found:.2f}."
