"""Subset selection by forward and swap steps, in which every set of candidates is refitted.

A ``Problem`` refits sets of candidates and proposes additions to them. Many cases (joints, robots)
are searched together, so that a problem can share launches between them.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any, Generic, Protocol, TypeVar

from sim2real.progress import Progress

Fit = TypeVar("Fit")
Start = TypeVar("Start")
Members = frozenset[Any]


@dataclass(frozen=True)
class Hypothesis(Generic[Fit]):
    """One set of candidates, fitted to one case; ``evidence`` is a logarithm, with the prior."""

    members: Members
    fit: Fit
    evidence: float


@dataclass
class Ledger(Generic[Fit]):
    """The best hypothesis of each set that was tried in one case; all have the ``base``."""

    case: int
    base: Members = frozenset()
    tried: dict[Members, Hypothesis[Fit]] = field(default_factory=dict)

    @property
    def plain(self) -> Hypothesis[Fit]:
        """The hypothesis with the base only."""
        return self.tried[self.base]

    @property
    def best(self) -> Hypothesis[Fit]:
        """The hypothesis with the largest evidence."""
        return max(self.tried.values(), key=lambda h: h.evidence)

    def keep(self, hypothesis: Hypothesis[Fit]) -> None:
        """Record a hypothesis, unless the same set already has a better fit."""
        previous = self.tried.get(hypothesis.members)
        if previous is None or hypothesis.evidence > previous.evidence:
            self.tried[hypothesis.members] = hypothesis

    def closest(self, most: int, within: float) -> list[Hypothesis[Fit]]:
        """The best hypothesis and its closest rivals of the same size, best first."""
        best = self.best
        rivals = [
            h
            for h in self.tried.values()
            if len(h.members) == len(best.members) and h.evidence > best.evidence - within
        ]
        return sorted(rivals, key=lambda h: -h.evidence)[:most]


Pair = tuple[Ledger[Fit], Members]
"""A case and a set of candidates."""
Job = tuple[Ledger[Fit], Members, Start]
"""A case, a set to refit and its start."""


class Problem(Protocol[Fit, Start]):
    """Interface of a selection problem, such as the servos of a robot or a swim."""

    def look(self, pairs: Sequence[Pair[Fit]]) -> None:
        """Prepare ``additions`` to these sets, in one batch if that is cheaper."""

    def additions(
        self, ledger: Ledger[Fit], members: Members, most: int | None
    ) -> Sequence[tuple[Hashable, Start]]:
        """Candidates to add, most promising first, with starts; at most ``most``."""

    def start(self, ledger: Ledger[Fit], members: Members) -> Start:
        """Start of the fit of a subset of the best set."""

    def refit(self, jobs: Sequence[Job[Fit, Start]]) -> Sequence[Hypothesis[Fit]]:
        """Fit each job; jobs of one set may share the fit of the best start."""

    def remains(self, ledger: Ledger[Fit], members: Members) -> bool:
        """Whether a further candidate could explain more than chance."""


@dataclass(frozen=True)
class Breadth:
    """Breadth of the search."""

    most: int = 4  # largest number of candidates in a set, without the base
    # number of additions tried for each set after the first round; None for all
    added: int | None = 6
    rivals: int = 3  # number of sets of the best size that are extended
    within: float = 12.0  # largest difference of their evidence to the best one


def select(
    problem: Problem[Fit, Start],
    ledgers: Sequence[Ledger[Fit]],
    breadth: Breadth = Breadth(),  # noqa: B008 - frozen
    progress: Progress = lambda share: None,
    exhausted: Callable[[Ledger[Fit]], bool] = lambda ledger: False,
) -> None:
    """Try sets of candidates in each case until none is better, or its budget is ``exhausted``."""
    problem.look([(ledger, ledger.base) for ledger in ledgers])
    _refit(problem, [job for x in ledgers for job in _enlarged(problem, x, x.base, None)])
    active = [ledger for ledger in ledgers if problem.remains(ledger, ledger.base)]
    for number in range(1, breadth.most):
        progress(number / breadth.most)
        active = [ledger for ledger in active if not exhausted(ledger)]
        if not active:
            break
        before = {ledger.case: ledger.best.members for ledger in active}
        _extend(problem, active, breadth)
        active = [ledger for ledger in active if ledger.best.members != before[ledger.case]]
    progress(1.0)


def widen(
    problem: Problem[Fit, Start], ledgers: Sequence[Ledger[Fit]], most: int = Breadth.most
) -> None:
    """Try every candidate with the best set of each case, up to ``most``, until none is better."""
    active = list(ledgers)
    while active:
        before = {ledger.case: ledger.best.members for ledger in active}
        problem.look([(ledger, ledger.best.members) for ledger in active])
        jobs = [job for x in active for job in _enlarged(problem, x, x.best.members, None)]
        _refit(problem, jobs)
        active = [
            ledger
            for ledger in active
            if ledger.best.members != before[ledger.case]
            and len(ledger.best.members - ledger.base) < most
        ]


def _extend(problem: Problem[Fit, Start], ledgers: Sequence[Ledger[Fit]], breadth: Breadth) -> None:
    """Add to the best sets, remove one or two of their members, and replace these."""
    larger = [
        (ledger, hypothesis.members)
        for ledger in ledgers
        for hypothesis in ledger.closest(breadth.rivals, breadth.within)
    ]
    smaller = [
        (ledger, ledger.best.members - set(out))
        for ledger in ledgers
        for count in (1, 2)
        for out in combinations(sorted(ledger.best.members - ledger.base, key=str), count)
    ]
    missing = [(x, s, problem.start(x, s)) for x, s in smaller if s not in x.tried]
    _refit(problem, missing)
    problem.look([*larger, *smaller])
    jobs = [
        job
        for ledger, members in larger
        if len(members - ledger.base) < breadth.most and problem.remains(ledger, members)
        for job in _enlarged(problem, ledger, members, breadth.added)
    ]
    jobs += [job for x, s in smaller for job in _enlarged(problem, x, s, breadth.added)]
    _refit(problem, [job for job in jobs if job[1] not in job[0].tried])


def _enlarged(
    problem: Problem[Fit, Start], ledger: Ledger[Fit], members: Members, most: int | None
) -> list[Job[Fit, Start]]:
    candidates = problem.additions(ledger, members, most)
    return [(ledger, members | {name}, start) for name, start in candidates]


def _refit(problem: Problem[Fit, Start], jobs: Sequence[Job[Fit, Start]]) -> None:
    if jobs:
        for (ledger, _, _), hypothesis in zip(jobs, problem.refit(jobs), strict=True):
            ledger.keep(hypothesis)
