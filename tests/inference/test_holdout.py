import numpy as np
import pytest

from sim2real.inference.folds import each_in_turn, rms, until


def test_each_is_held_out_once():
    pairs = each_in_turn(["a", "b", "c"])
    assert [one for _, one in pairs] == ["a", "b", "c"]
    assert all(one not in rest and len(rest) == 2 for rest, one in pairs)


def test_the_end_of_a_lone_recording_is_held_out():
    t = np.array([10.0, 11.0, 18.0, 20.0])
    assert until(t) == pytest.approx(17.5)
    assert until(t, 0.5) == pytest.approx(15.0)


def test_the_error_is_that_of_all_samples_together():
    assert rms([np.array([3.0]), np.array([4.0, 0.0])]) == pytest.approx(np.sqrt(25 / 3))
    assert rms([]) == 0.0
