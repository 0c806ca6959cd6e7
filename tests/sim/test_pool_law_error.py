"""What is learned of the twin's error from swims in which nothing is missing."""

import importlib
from pathlib import Path

import numpy as np
import pytest


@pytest.fixture
def learning(monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parents[2])
    return importlib.import_module("benchmarks.pool_law_error")


def robots(learning, rng, own, common, usual, count=40, swims=6):
    """Robots of two columns: a law that is the robot's, an error that is a swim's and the robot's.

    Each swim tells both, in noise of 0.01.
    """
    slope = np.zeros((60, 2))
    slope[0, 0] = slope[4, 1] = 1.0
    out = []
    for _ in range(count):
        law, shared = rng.normal(usual, common), rng.normal(0, common)
        errors = []
        for _ in range(swims):
            rows = 0.01 * rng.standard_normal(60)
            rows[0] -= law
            rows[4] -= shared + rng.normal(0, own)
            errors.append({
                "rows": rows, "slope": slope, "noise": np.full((15, 4), 1e-4),
                "power": np.ones((15, 4)), "band": np.arange(15) % 3,
            })  # fmt: skip
        kinds = ["twin.across", "error.surge_0"]
        out.append(learning.Near(errors, kinds, [1.0, 0.0], np.full(2, 0.01), np.zeros(2)))
    return out


def test_what_robots_differ_by_and_what_their_swims_do_are_told_apart(learning):
    own, common, usual = 0.05, 0.2, 0.4
    given = robots(learning, np.random.default_rng(0), own, common, usual)
    levels = (
        np.full((4, 3), 0.01), {"error.surge_0": 0.1},
        {"twin.across": 0.1, "error.surge_0": 0.1}, {"twin.across": 0.0},
    )  # fmt: skip
    for _ in range(40):
        levels = learning.sizes(given, levels, {})
    shares, swim, robot, middle = levels
    assert swim["error.surge_0"] == pytest.approx(own, rel=0.15)
    assert robot["error.surge_0"] == pytest.approx(common, rel=0.3)
    assert robot["twin.across"] == pytest.approx(common, rel=0.3)
    assert middle["twin.across"] == pytest.approx(usual, abs=0.08)
    assert np.all(shares < 0.01)


def test_what_was_known_of_robots_counts(learning):
    few = robots(learning, np.random.default_rng(1), 0.05, 0.2, 0.0, count=2)
    begun = (
        np.full((4, 3), 0.01), {"error.surge_0": 0.05},
        {"twin.across": 1.0, "error.surge_0": 0.2}, {"twin.across": 0.0},
    )  # fmt: skip
    free, held = begun, begun
    for _ in range(20):
        free = learning.sizes(few, free, {})
        held = learning.sizes(few, held, {"twin.across": 1.0})
    assert held[2]["twin.across"] > 3 * free[2]["twin.across"]
