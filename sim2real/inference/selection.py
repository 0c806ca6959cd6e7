"""The search: which candidates does a problem need? Forward and swap steps; every set is refitted.

A problem is what ``Problem`` says: it refits sets of candidates and knows which are worth trying.
Many cases (joints, robots) go along together, so that a problem may share launches between them.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any, Generic, Protocol, TypeVar

Fit = TypeVar("Fit")
Start = TypeVar("Start")
Members = frozenset[Any]


@dataclass(frozen=True)
class Hypothesis(Generic[Fit]):
    """One set of candidates, fitted to one case.

    Attributes:
        members: The candidates.
        fit: The best fit of them.
        evidence: Logarithm of the marginal likelihood and prior, up to a constant of the case.
    """

    members: Members
    fit: Fit
    evidence: float


@dataclass
class Ledger(Generic[Fit]):
    """Everything that was tried in one case.

    Attributes:
        case: Which case.
        base: What every set has.
        tried: The best of each set.
    """

    case: int
    base: Members = frozenset()
    tried: dict[Members, Hypothesis[Fit]] = field(default_factory=dict)

    @property
    def plain(self) -> Hypothesis[Fit]:
        """The base alone."""
        return self.tried[self.base]

    @property
    def best(self) -> Hypothesis[Fit]:
        """The set of the largest evidence."""
        return max(self.tried.values(), key=lambda h: h.evidence)

    def keep(self, found: Hypothesis[Fit]) -> None:
        """Take it down, unless the same set was fitted better before."""
        known = self.tried.get(found.members)
        if known is None or found.evidence > known.evidence:
            self.tried[found.members] = found

    def closest(self, most: int, within: float) -> list[Hypothesis[Fit]]:
        """The best set and its closest rivals of the same size, best first."""
        best = self.best
        rivals = [
            h
            for h in self.tried.values()
            if len(h.members) == len(best.members) and h.evidence > best.evidence - within
        ]
        return sorted(rivals, key=lambda h: -h.evidence)[:most]


Pair = tuple[Ledger[Fit], Members]
"""A set in a case."""
Job = tuple[Ledger[Fit], Members, Start]
"""A set to refit in a case, and where its fit begins."""


class Problem(Protocol[Fit, Start]):
    """What the search asks of the servos of a robot, or of a swim."""

    def look(self, pairs: Sequence[Pair[Fit]]) -> None:
        """Get ready to say what may join these sets, all in one go; nothing where it is cheap."""

    def additions(
        self, ledger: Ledger[Fit], members: Members, most: int | None
    ) -> Sequence[tuple[Hashable, Start]]:
        """What may join a set, likeliest first, each with a start; ``most`` candidates at most."""

    def start(self, ledger: Ledger[Fit], members: Members) -> Start:
        """Where the fit of a set begins that is a part of the best one."""

    def refit(self, jobs: Sequence[Job[Fit, Start]]) -> Sequence[Hypothesis[Fit]]:
        """Fit each job; of a set with several starts the best may be given for all."""

    def remains(self, ledger: Ledger[Fit], members: Members) -> bool:
        """Whether something could still explain more than chance."""


@dataclass(frozen=True)
class Breadth:
    """How widely the search goes.

    Attributes:
        most: Candidates beyond the base that a set may have.
        added: Candidates that are tried beside each set beyond single ones; all where None.
        rivals: Sets of the best size that are gone on from.
        within: How far their evidence may be behind.
        swaps: Whether members are left out and another put in their place.
    """

    most: int = 4
    added: int | None = 6
    rivals: int = 3
    within: float = 12.0
    swaps: bool = True


def select(
    problem: Problem[Fit, Start],
    ledgers: Sequence[Ledger[Fit]],
    breadth: Breadth = Breadth(),  # noqa: B008 - frozen
    progress: Callable[[float], None] = lambda share: None,
    exhausted: Callable[[Ledger[Fit]], bool] = lambda ledger: False,
) -> None:
    """Try sets of candidates in every case until none is better; the ledgers keep them all.

    Args:
        problem: What is searched.
        ledgers: One a case; each holds its base, fitted.
        breadth: How widely.
        progress: Called with the share that is done.
        exhausted: Whether a case that would go on to larger sets has spent its budget.
    """
    problem.look([(ledger, ledger.base) for ledger in ledgers])
    _refit(problem, [job for one in ledgers for job in _grown(problem, one, one.base, None)])
    going = [ledger for ledger in ledgers if problem.remains(ledger, ledger.base)]
    for number in range(1, breadth.most):
        progress(number / breadth.most)
        going = [ledger for ledger in going if not exhausted(ledger)]
        if not going:
            break
        before = {ledger.case: ledger.best.members for ledger in going}
        _extend(problem, going, breadth)
        going = [ledger for ledger in going if ledger.best.members != before[ledger.case]]
    progress(1.0)


def _extend(problem: Problem[Fit, Start], ledgers: Sequence[Ledger[Fit]], breadth: Breadth) -> None:
    """Add to the best sets, leave out one or two of their members, put another in the place."""
    larger = [
        (ledger, hypothesis.members)
        for ledger in ledgers
        for hypothesis in ledger.closest(breadth.rivals, breadth.within)
    ]
    smaller = [
        (ledger, ledger.best.members - set(out))
        for ledger in ledgers
        for count in ((1, 2) if breadth.swaps else ())
        for out in combinations(sorted(ledger.best.members - ledger.base, key=str), count)
    ]
    missing = [(one, s, problem.start(one, s)) for one, s in smaller if s not in one.tried]
    _refit(problem, missing)
    problem.look([*larger, *smaller])
    jobs = [
        job
        for ledger, members in larger
        if len(members - ledger.base) < breadth.most and problem.remains(ledger, members)
        for job in _grown(problem, ledger, members, breadth.added)
    ]
    jobs += [
        job
        for ledger, members in smaller
        for job in _grown(problem, ledger, members, breadth.added)
    ]
    _refit(problem, [job for job in jobs if job[1] not in job[0].tried])


def _grown(
    problem: Problem[Fit, Start], ledger: Ledger[Fit], members: Members, most: int | None
) -> list[Job[Fit, Start]]:
    every = problem.additions(ledger, members, most)
    return [(ledger, members | {name}, start) for name, start in every]


def _refit(problem: Problem[Fit, Start], jobs: Sequence[Job[Fit, Start]]) -> None:
    if jobs:
        for (ledger, _, _), found in zip(jobs, problem.refit(jobs), strict=True):
            ledger.keep(found)
