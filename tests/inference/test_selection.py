"""The search for a set, on problems whose answer is known; the Occam factor of a linear model."""

import numpy as np
import pytest

from sim2real.inference.evidence import occam_factor
from sim2real.inference.selection import Breadth, Hypothesis, Ledger, select, widen

NAMES = "abcdef"
WEIGHT = {"c": 0.5}


class Linear:
    """Regression on some of six columns; a case is one vector of observations."""

    def __init__(self, design, observed):
        self.design, self.observed, self.fits, self.looks = design, observed, 0, 0

    def hypothesis(self, case, members):
        self.fits += 1
        B = self.design[:, [NAMES.index(m) for m in sorted(members)]]
        curvature = B.T @ B + np.eye(B.shape[1]) / 25
        best = np.linalg.solve(curvature, B.T @ self.observed[case])
        left = self.observed[case] - B @ best
        loss = 0.5 * left @ left + 0.5 * best @ best / 25
        occam = 0.5 * np.linalg.slogdet(25 * curvature)[1]
        evidence = -loss - occam - 2.0 * len(members)
        return Hypothesis(members, best, evidence)

    def look(self, places):
        self.looks += 1

    def additions(self, ledger, members, most):
        every = [n for n in NAMES if n not in members]
        gain = {n: self.hypothesis(ledger.case, members | {n}).evidence for n in every}
        every.sort(key=lambda n: -gain[n])
        return [(n, None) for n in every[:most]]

    def start(self, ledger, members):
        return None

    def refit(self, jobs):
        return [self.hypothesis(ledger.case, members) for ledger, members, _ in jobs]

    def remains(self, ledger, members):
        return ledger.tried[members].evidence < ledger.best.evidence + 1e9


def problem(*truths, seed=0):
    rng = np.random.default_rng(seed)
    design = rng.standard_normal((200, 6))
    design[:, 0] = (design[:, 1] + design[:, 2]) / np.sqrt(2) + 0.3 * design[:, 0]
    observed = [
        sum((WEIGHT.get(n, 1.0) * design[:, NAMES.index(n)] for n in truth), np.zeros(200))
        + 0.3 * rng.standard_normal(200)
        for truth in truths
    ]
    return Linear(design, observed)


def begun(given, base=""):
    """A ledger of each case, with the fit of its base."""
    ledgers = [Ledger(case, frozenset(base)) for case in range(len(given.observed))]
    for ledger in ledgers:
        ledger.keep(given.hypothesis(ledger.case, ledger.base))
    return ledgers


def searched(given, breadth=Breadth(), base=""):  # noqa: B008
    ledgers = begun(given, base)
    select(given, ledgers, breadth)
    return ledgers


@pytest.mark.parametrize("truth", ["", "d", "de", "def"])
def test_what_is_there_is_found(truth):
    (ledger,) = searched(problem(truth))
    assert ledger.best.members == frozenset(truth)


def test_a_stand_in_is_swapped_for_the_two_that_it_stood_for():
    """``a`` is much like ``b`` and ``c`` together, and alone explains most of them."""
    given = problem("bc")
    alone = {n: given.hypothesis(0, frozenset(n)).evidence for n in NAMES}
    assert max(alone, key=alone.get) == "a"
    (ledger,) = searched(given)
    assert ledger.best.members == frozenset("bc")


def test_cases_go_along_together_and_do_not_mix():
    truths = ["bc", "", "f"]
    together = searched(problem(*truths))
    for case, truth in enumerate(truths):
        assert together[case].best.members == frozenset(truth)


def test_no_set_is_larger_than_allowed():
    (ledger,) = searched(problem("bdef"), Breadth(most=2))
    assert max(len(s) for s in ledger.tried) == 2


def test_a_base_stays():
    (ledger,) = searched(problem("df"), base="d")
    assert ledger.best.members == frozenset("df")
    assert all("d" in members for members in ledger.tried)


def test_the_better_fit_of_a_set_is_kept():
    ledger = Ledger(0)
    for evidence in (1.0, 3.0, 2.0):
        ledger.keep(Hypothesis(frozenset("x"), evidence, evidence))
    assert ledger.best.fit == 3.0


def test_a_case_without_budget_is_searched_no_further_than_single_candidates():
    given = problem("bde", "bde")
    ledgers = begun(given)
    select(given, ledgers, exhausted=lambda ledger: ledger.case == 1)
    assert ledgers[0].best.members == frozenset("bde")
    assert {len(members) for members in ledgers[1].tried} == {0, 1}
    assert len(ledgers[1].tried) == 1 + len(NAMES)


def test_a_set_whose_fit_was_poor_is_tried_again_from_a_better_place():
    given = problem("de")
    (ledger,) = begun(given)
    ledger.keep(given.hypothesis(0, frozenset("d")))
    poor = given.hypothesis(0, frozenset("de"))
    ledger.keep(Hypothesis(poor.members, poor.fit, ledger.plain.evidence - 100.0))
    widen(given, [ledger])
    assert ledger.best.members == frozenset("de")
    assert ledger.best.evidence == poor.evidence


def test_no_set_is_widened_beyond_the_most():
    given = problem("def")
    (ledger,) = begun(given)
    widen(given, [ledger], most=2)
    assert len(ledger.best.members) == 2


RNG = np.random.default_rng(3)
A = RNG.standard_normal((30, 3))


def test_occam_counts_what_nuisances_leave():
    information = A.T @ A
    left = information[2, 2] - information[2, :2] @ np.linalg.solve(
        information[:2, :2], information[:2, 2]
    )
    found = occam_factor(information[None], 2.0, nuisance=2)[0]
    assert found == pytest.approx(0.5 * np.log(1 + 4 * left))
    assert occam_factor(information[None], 2.0, nuisance=3)[0] == 0.0
