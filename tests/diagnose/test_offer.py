"""The enriched model has no effect that is negligible and predicts no better."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.missing.offer import offer, simpler
from sim2real.identification.held_out import Unseen

BASE: frozenset[str] = frozenset()
SMALL, BOTH = frozenset({"coulomb_friction"}), frozenset({"coulomb_friction", "deadband"})


def finding(*sets: frozenset[str], **changes: float) -> Any:
    """What was tried, and by what share each effect lowers the held-out error."""
    tried = {members: SimpleNamespace(members=members) for members in (BASE, *sets)}
    return SimpleNamespace(
        tried=SimpleNamespace(base=BASE, tried=tried),
        changes=lambda unseen, effect: changes[effect],
    )


def unseen(**rmse: float) -> dict[frozenset[str], Unseen]:
    sets = {"base": BASE, "small": SMALL, "both": BOTH}
    return {sets[k]: Unseen((np.full(4, x),), np.zeros((1, 1))) for k, x in rmse.items()}


NEGLIGIBLE = 0.5 * DECISION.negligible


def test_negligible_effects_are_what_is_taken_off() -> None:
    result = finding(SMALL, BOTH, coulomb_friction=0.5, deadband=NEGLIGIBLE)
    assert simpler(result, result.tried.tried[BOTH], {}) == SMALL
    result = finding(SMALL, BOTH, coulomb_friction=0.5, deadband=2 * DECISION.negligible)
    assert simpler(result, result.tried.tried[BOTH], {}) == BOTH
    result = finding(SMALL, BOTH, coulomb_friction=NEGLIGIBLE, deadband=NEGLIGIBLE)
    assert simpler(result, result.tried.tried[BOTH], {}) == BASE


def test_a_set_that_was_not_tried_is_not_offered() -> None:
    result = finding(BOTH, coulomb_friction=0.5, deadband=NEGLIGIBLE)
    assert simpler(result, result.tried.tried[BOTH], {}) == BOTH


@pytest.mark.parametrize(
    ("more", "expected"), [(1.0, SMALL), (0.995, SMALL), (1.2, SMALL), (0.97, BOTH)]
)
def test_it_stays_where_it_lowers_the_held_out_error(more: float, expected: frozenset[str]) -> None:
    result = finding(SMALL, BOTH, coulomb_friction=0.5, deadband=NEGLIGIBLE)
    held_out = unseen(small=1.0, both=more)
    assert offer(result, result.tried.tried[BOTH], SMALL, held_out).members == expected


def test_nothing_is_taken_off_where_nothing_is_held_out() -> None:
    result = finding(SMALL, BOTH, coulomb_friction=np.inf, deadband=np.inf)
    rich = result.tried.tried[BOTH]
    assert simpler(result, rich, {}) == BOTH
    assert offer(result, rich, SMALL, {}) is rich
