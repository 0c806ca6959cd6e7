"""Metrics of swims whose answers are known."""

import numpy as np
import pytest

from rl.experiments.episodes import energy, path_length


def test_energy_is_the_sum_of_squares_of_what_is_known() -> None:
    rate = np.full((101, 3, 3), 2.0)
    rate[51:, 1], rate[:, 2] = np.nan, np.nan
    assert energy(rate)[:2].tolist() == [101 * 12.0, 51 * 12.0]
    assert np.isnan(energy(rate)[2])


def test_path_of_a_straight_line() -> None:
    line = np.linspace(0, 1, 51)[:, None, None] * np.array([[3.0, 4.0], [0.0, 0.0]])
    line[41:, 0] = np.nan
    assert path_length(line) == pytest.approx([4.0, 0.0])
