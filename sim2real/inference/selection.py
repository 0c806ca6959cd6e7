"""Subset selection by forward and swap steps, in which every set of candidates is refitted.

Many cases (joints, robots) are searched together, so that a problem can share launches.
"""

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
    problem.look([(x, x.base) for x in ledgers])
    _refit(problem, [job for x in ledgers for job in _enlarged(problem, x, x.base, None)])
    active = [x for x in ledgers if problem.remains(x, x.base)]
    for number in range(1, breadth.most):
        progress(number / breadth.most)
        active = [x for x in active if not exhausted(x)]
        if not active:
            break
        before = {x.case: x.best.members for x in active}
        _extend(problem, active, breadth)
        active = [x for x in active if x.best.members != before[x.case]]
    progress(1.0)


def widen(
    problem: Problem[Fit, Start], ledgers: Sequence[Ledger[Fit]], most: int = Breadth.most
) -> None:
    """Try every candidate with the best set of each case, up to ``most``, until none is better."""
    active = list(ledgers)
    while active:
        before = {x.case: x.best.members for x in active}
        problem.look([(x, x.best.members) for x in active])
        jobs = [job for x in active for job in _enlarged(problem, x, x.best.members, None)]
        _refit(problem, jobs)
        active = [x for x in active if x.best.members != before[x.case]]
        active = [x for x in active if len(x.best.members - x.base) < most]


def _extend(problem: Problem[Fit, Start], ledgers: Sequence[Ledger[Fit]], breadth: Breadth) -> None:
    """Add to the best sets, remove one or two of their members, and replace these."""
    larger: list[Pair[Fit]] = []
    smaller: list[Pair[Fit]] = []
    for x in ledgers:
        best, near = x.best, x.best.evidence - breadth.within
        rivals = [h for h in x.tried.values() if len(h.members) == len(best.members)]
        rivals = sorted((h for h in rivals if h.evidence > near), key=lambda h: -h.evidence)
        larger += [(x, h.members) for h in rivals[: breadth.rivals]]
        for count in (1, 2):
            fewer = combinations(sorted(best.members - x.base, key=str), count)
            smaller += [(x, best.members - set(out)) for out in fewer]
    _refit(problem, [(x, s, problem.start(x, s)) for x, s in smaller if s not in x.tried])
    problem.look([*larger, *smaller])
    larger = [(x, s) for x, s in larger if len(s - x.base) < breadth.most and problem.remains(x, s)]
    jobs = [job for x, s in (*larger, *smaller) for job in _enlarged(problem, x, s, breadth.added)]
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
