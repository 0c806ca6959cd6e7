"""What is learned of the twin's error from swims in which nothing is missing."""

import importlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sim.inference.law_error import LAW_ERROR


@pytest.fixture
def sizes(monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parents[2])
    return importlib.import_module("benchmarks.pool_law_error").sizes


def test_what_references_leave_uncertain_is_not_the_robots_change(sizes):
    rng = np.random.default_rng(0)
    own, references = 0.05, 0.1
    slope = np.zeros((60, 1))
    slope[0] = 1e4  # each swim tells its coefficient
    swims = [
        {
            "rows": np.zeros(60), "slope": slope, "off": np.array([off]),
            "spread": np.array([[references**2]]), "noise": np.ones((15, 4)),
            "power": np.ones((15, 4)), "band": np.arange(15) % 3,
            "kinds": ["twin.across"], "nominal": [1.0],
        }
        for off in rng.normal(0, np.hypot(own, references), 200)
    ]  # fmt: skip
    imitated = {"twin.across": 0.1}
    before = replace(LAW_ERROR, imitated=dict(imitated))
    for _ in range(25):
        _, fresh = sizes(swims, np.full((4, 3), 0.1), imitated, before, 10.0)
        imitated |= fresh
    assert imitated["twin.across"] == pytest.approx(own, rel=0.35)
