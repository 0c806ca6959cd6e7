"""What a designed recording was expected to tell of rival sets of effects, and what it told."""

from __future__ import annotations

from dataclasses import dataclass

from sim2real.effects import named


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
        both = f"{_words(self.first, self.second)} from {_words(self.second, self.first)}"
        stated = f"{self.component}: expected to separate {both} with {self.expected:.2f}"
        if self.found is None:
            return f"{stated}; both are ruled out."
        if self.found < SEPARATED:
            return f"{stated}; not separated, {self.found:.2f}."
        other = self.second if self.favoured == self.first else self.first
        return f"{stated}; separated, {self.found:.2f} for {_words(self.favoured, other)}."


SEPARATED = 0.9
"""Probability from which one of two sets is told from the other."""


def _words(effects: tuple[str, ...], other: tuple[str, ...]) -> str:
    """The effects of a set that the other lacks, in words."""
    own = [named(effect).plain for effect in effects if effect not in other]
    return " and ".join(own) or "none of it"
