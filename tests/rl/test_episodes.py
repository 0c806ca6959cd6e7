"""Metrics of swims whose answers are known."""

from __future__ import annotations

import numpy as np
import pytest

from rl.experiments.episodes import circle_radius, energy, path_length, turning_radius


def circling(radius: np.ndarray, turned: float, rows: int = 200) -> tuple[np.ndarray, np.ndarray]:
    """Positions (T, E, 2) and headings (T, E) of robots on circles, anticlockwise."""
    heading = np.linspace(0.3, 0.3 + turned, rows)[:, None] * np.ones(radius.size)
    centre = np.array([5.0, -3.0])
    side = np.stack([np.sin(heading), -np.cos(heading)], axis=2)
    return centre + radius[:, None] * side, heading


def test_circle_of_known_radius() -> None:
    radius = np.array([0.05, 0.4, 3.0])
    position, heading = circling(radius, np.pi)
    assert turning_radius(position, heading) == pytest.approx(radius)
    assert turning_radius(position[:, :, ::-1], -heading) == pytest.approx(radius)  # to the right


def test_the_tails_beat_hardly_moves_the_radius() -> None:
    position, heading = circling(np.array([0.3]), np.pi)
    beat = 0.01 * np.sin(np.linspace(0, 30, 200))[:, None]
    outward = np.stack([np.sin(heading), -np.cos(heading)], axis=2)
    wobbling = position + beat[..., None] * outward
    assert turning_radius(wobbling, heading + 5 * beat) == pytest.approx(0.3, rel=0.03)


def test_only_the_middle_of_the_turn_counts() -> None:
    position, heading = circling(np.array([0.3]), np.pi)
    straight = position[0] - np.linspace(1, 0.01, 50)[:, None, None] * [[np.cos(0.3), np.sin(0.3)]]
    way, angle = (
        np.concatenate([straight, position]),
        np.concatenate([heading[:1]] * 50 + [heading]),
    )
    assert turning_radius(way, angle) == pytest.approx(0.3)


def test_no_turn_no_radius_and_a_straight_line_an_infinite_one() -> None:
    line = np.linspace(0, 1, 50)[:, None, None] * np.array([[1.0, 2.0]])
    assert np.isnan(turning_radius(line, np.zeros((50, 1)))[0])
    assert np.isinf(circle_radius(line)[0])
    assert np.isnan(circle_radius(np.full((5, 1, 2), np.nan))[0])


def test_energy_is_the_sum_of_squares_of_what_is_known() -> None:
    rate = np.full((101, 3, 3), 2.0)
    rate[51:, 1], rate[:, 2] = np.nan, np.nan
    assert energy(rate)[:2].tolist() == [101 * 12.0, 51 * 12.0]
    assert np.isnan(energy(rate)[2])


def test_path_of_a_straight_line() -> None:
    line = np.linspace(0, 1, 51)[:, None, None] * np.array([[3.0, 4.0], [0.0, 0.0]])
    line[41:, 0] = np.nan
    assert path_length(line) == pytest.approx([4.0, 0.0])
