"""Benches that a short first recording leaves open: gentle, at rest at both ends."""

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

DATASETS = Path(__file__).resolve().parents[2] / "datasets"


@pytest.fixture
def open_cases(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    before = set(sys.modules)
    for folder in ("concealed", "foreign"):
        monkeypatch.syspath_prepend(str(DATASETS / folder))
    yield importlib.import_module("open_cases")
    for name in set(sys.modules) - before:
        if str(DATASETS) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


def test_a_first_recording_is_small_and_at_rest_at_both_ends(open_cases: ModuleType) -> None:
    t = np.arange(0.0, 9.0, 0.02)
    for seed in range(40):
        command = open_cases.gentle(t, np.random.default_rng(seed))
        assert 0 < np.abs(command).max() <= open_cases.REACH_RAD[1]
        assert not command[t <= 0.8].any() and not command[t >= t[-1] - 0.8].any()


def test_a_hidden_effect_shows_to_one_who_knows_the_plant(open_cases: ModuleType) -> None:
    case = open_cases.draw_open_case(np.random.default_rng([2, 1, 0]))
    told = open_cases.knower.consult(case, ["a"])
    assert len(case.servos) == 1 and set(case.takes) == {"a", "c"}
    low, high = open_cases.NATS
    assert low / 2 <= told["llr_total"] <= 2 * high
