"""Rival sets of effects that a recording was designed to distinguish, and the outcome."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from sim2real.effects import plain
from sim2real.structured import Fields

SEPARATED = 0.9
"""Probability from which two sets of effects count as distinguished."""


def in_words(effects: tuple[str, ...], other: tuple[str, ...] = ()) -> str:
    """The effects of a set that another set lacks."""
    return " and ".join(plain(effect) for effect in effects if effect not in other)


def task(first: tuple[str, ...], second: tuple[str, ...]) -> str:
    """How two sets differ, as a clause without a subject."""
    here, there = in_words(first, second), in_words(second, first)
    if here and there:
        return f"separate {here} from {there}"
    return f"show whether there is {here or there}"


@dataclass(frozen=True)
class Separation:
    """Two sets of effects that a recording was to distinguish.

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


def separations(
    component: str,
    stated: Iterable[Fields],
    probability: Mapping[frozenset[str], float],
    *,
    most: int = 6,
    least: float = 1e-3,
) -> tuple[Separation, ...]:
    """Expectation and outcome of what recordings were designed to distinguish in a component.

    Args:
        component: The joint or the body.
        stated: What the JSON of the recordings says of it, see ``rival_sets.design_of``.
        probability: Probabilities of the sets of effects, given all recordings.
        most: Largest number of pairs of a recording, those that mattered most.
        least: Probability of both sets below which they are ruled out.

    Raises:
        InputError: If a statement is of another form.
    """
    return tuple(
        _separation(component, pair, probability, least)
        for entry in stated
        for pair in (entry.tables("pairs")[:most] if "pairs" in entry else ())
    )


def _separation(
    component: str, pair: Fields, probability: Mapping[frozenset[str], float], least: float
) -> Separation:
    first, second = (tuple(pair.sentences(name)) for name in ("first", "second"))
    weights = _weight(probability, first, second), _weight(probability, second, first)
    total = sum(weights)
    return Separation(
        component,
        first,
        second,
        pair.number("expected"),
        max(weights) / total if total > least else None,
        first if weights[0] >= weights[1] else second,
    )


def _weight(
    probability: Mapping[frozenset[str], float], own: tuple[str, ...], other: tuple[str, ...]
) -> float:
    """Probability of the sets that have what ``own`` has more than ``other``, and no converse."""
    needed, excluded = set(own) - set(other), set(other) - set(own)
    return sum(
        p for effects, p in probability.items() if needed <= effects and not excluded & effects
    )
