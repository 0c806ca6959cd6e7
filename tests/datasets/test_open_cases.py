"""Benches that a first recording leaves open: gentle, at rest at both ends, of stated size."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("numba", reason="generating cases needs numba")
pytest.importorskip("mujoco", reason="one of the plants is MuJoCo's")

DATASETS = Path(__file__).parents[2] / "datasets"


@pytest.fixture(scope="module")
def open_cases(scripts):
    folders = DATASETS / "foreign", DATASETS / "concealed"
    with scripts(*folders, names=("open_cases",)) as modules:
        yield modules["open_cases"]


def test_a_first_recording_is_small_and_at_rest_at_both_ends(open_cases):
    t = np.arange(0.0, 9.0, 0.02)
    for seed in range(40):
        command = open_cases.gentle(t, np.random.default_rng(seed))
        assert 0 < np.abs(command).max() <= open_cases.REACH_RAD[1]
        assert not command[t <= 0.8].any() and not command[t >= t[-1] - 0.8].any()


def test_a_hidden_effect_shows_to_one_who_knows_the_plant(open_cases):
    case = open_cases.draw_open_case(np.random.default_rng([2, 1, 0]))
    told = open_cases.knower.consult(case, ["a"])
    assert len(case.servos) == 1 and set(case.takes) == {"a", "c"}
    low, high = open_cases.NATS
    assert low / 2 <= told["llr_total"] <= 2 * high
