"""The search for effects that swims show: the shared one, for one robot."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from sim2real.inference.parameters import Parameter
from sim2real.inference.selection import Breadth, Hypothesis, Ledger, Members, select

Array = NDArray[np.float64]
Fit = TypeVar("Fit")

MOST = 2
"""Effects that are looked for together."""
ALIKE = 1.0
"""Difference in gain below which two effects cannot be told apart."""


@dataclass(frozen=True)
class Effect:
    """An effect that may be missing.

    Attributes:
        name: Its identifier.
        component: The material it belongs to, or ``body`` or ``camera``.
        free: Its parameters.
    """

    name: str
    component: str
    free: tuple[Parameter, ...]


@dataclass(frozen=True)
class Tried(Generic[Fit]):
    """An effect with its fit.

    Attributes:
        effect: The effect.
        gain: Logarithm of the evidence that it adds.
        fit: The fit of all.
        rivals: What else was tried when it was kept, best first.
    """

    effect: Effect
    gain: float
    fit: Fit
    rivals: tuple[Tried[Fit], ...] = ()

    @property
    def alike(self) -> list[Tried[Fit]]:
        """Effects that the swims cannot tell from this one."""
        return [other for other in self.rivals if self.gain - other.gain < ALIKE]


@dataclass(frozen=True)
class EffectSearch(Generic[Fit]):
    """Effects as candidates of ``inference.selection``; a swim is simulated as a whole for each.

    Attributes:
        effects: What may be missing.
        fitted: The fit with some effects.
        gain: Evidence that an effect adds, from the fits without and with it.
        enough: Gain from which an effect is named: what each costs in evidence.
        tell: Called after each fit.
    """

    effects: Sequence[Effect]
    fitted: Callable[[Sequence[Effect]], Fit]
    gain: Callable[[Fit, Fit, Effect], float]
    enough: float
    tell: Callable[[], None] = lambda: None

    def look(self, pairs: Sequence[tuple[Ledger[Fit], Members]]) -> None:
        """Nothing to get ready."""

    def additions(
        self, ledger: Ledger[Fit], members: Members, most: int | None
    ) -> Sequence[tuple[Hashable, None]]:
        """Every other effect."""
        return [(one, None) for one in self.effects if one not in members][:most]

    def start(self, ledger: Ledger[Fit], members: Members) -> None:
        """Fits begin at what the parameters usually are."""

    def refit(self, jobs: Sequence[tuple[Ledger[Fit], Members, None]]) -> list[Hypothesis[Fit]]:
        """Each set beside the best that has one effect less."""
        found = []
        for ledger, members, _ in jobs:
            less = [members - {one} for one in members if members - {one} in ledger.tried]
            before = max((ledger.tried[part] for part in less), key=lambda h: h.evidence)
            (new,) = members - before.members
            fit = self.fitted([one for one in self.effects if one in members])
            assert isinstance(new, Effect)
            gain = self.gain(before.fit, fit, new) - self.enough
            found.append(Hypothesis(members, fit, before.evidence + gain))
            self.tell()
        return found

    def remains(self, ledger: Ledger[Fit], members: Members) -> bool:
        """Whether what was found is worth going on from."""
        return ledger.best.members > ledger.base

    def run(
        self, plain: Fit, base: Sequence[Effect] = (), most: int = MOST
    ) -> tuple[list[Tried[Fit]], list[Tried[Fit]]]:
        """Search from a fit with some effects.

        Args:
            plain: The fit.
            base: Its effects.
            most: Effects to add.

        Returns:
            What is kept beyond the base, in order, and what was last considered, best first.
        """
        ledger: Ledger[Fit] = Ledger(0, frozenset(base))
        ledger.keep(Hypothesis(ledger.base, plain, 0.0))
        if most > 0:
            select(self, [ledger], Breadth(most=most, added=None, rivals=1))
        kept: list[Tried[Fit]] = []
        now, best = ledger.base, ledger.best.members
        while now != best:
            first, *_ = every = [one for one in self._beside(ledger, now) if one.effect in best]
            rivals = [one for one in self._beside(ledger, now) if one.effect != first.effect]
            kept.append(Tried(first.effect, first.gain, first.fit, tuple(rivals)))
            now = now | {every[0].effect}
        last = self._beside(ledger, best) or list(kept[-1].rivals if kept else ())
        return kept, last

    def _beside(self, ledger: Ledger[Fit], members: Members) -> list[Tried[Fit]]:
        """What was tried beside a set, best first."""
        found = []
        for one in self.effects:
            more = ledger.tried.get(members | {one})
            if one not in members and more is not None:
                gain = more.evidence - ledger.tried[members].evidence + self.enough
                found.append(Tried(one, gain, more.fit))
        return sorted(found, key=lambda one: -one.gain)
