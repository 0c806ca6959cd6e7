"""The simulator's own error: shapes in the signals, those of a robot and those of one swim."""

from dataclasses import replace

import numpy as np
import pytest
from swimming_robots import FISH, servos
from test_diagnose_swims import IN_WATER, only, swum

from benchmarks import pool_law_error as learning
from sim.inference import signal_error
from sim.inference.coordinates import Coordinates, signals_at, signals_of
from sim.inference.law_error import learned
from sim.inference.searched import searched
from sim.inference.swim_problem import COST, SwimProblem
from sim.inference.swims import by_followed_twin
from sim2real.model import read_model, write_model

OURS = replace(IN_WATER, shift={}, usual={})


@pytest.fixture(autouse=True)
def few(monkeypatch):
    only(monkeypatch, ("camera_latency", "linear_drag"))


def slower(swim, share):
    """The same with all ways forward shorter by a share."""
    signals = swim.signals.copy()
    signals[:, 0] *= 1 - share
    return replace(swim, signals=signals)


def test_shapes_are_of_one_signal_each_and_small_ones_add_up():
    signals = swum({}).signals
    shapes = signal_error.shapes(signals)
    assert list(shapes) == list(signal_error.kinds_of(3))
    for one in shapes.values():
        assert one.shape == signals.shape
        assert np.count_nonzero(np.abs(one).max(axis=0)) == 1
    both = shapes["error.surge_0"] + shapes["error.surge_swing"]
    np.testing.assert_allclose(both[:, 0], signals[:, 0], atol=1e-12)
    t = 0.02 * np.arange(600)
    wave, moved = (np.tile(np.sin(6 * (t - late))[:, None], 6) for late in (0.0, 0.01))
    said = wave + 0.01 * signal_error.shapes(wave)["error.joint0.late"]
    assert np.abs(said - moved)[60:-60, 3].max() < 0.15 * np.abs(moved - wave).max()


def test_what_all_swims_of_a_robot_are_wrong_by_is_foretold(tmp_path):
    """References that are slower than the twin, by more than its law may be: so is what follows."""
    simulate = by_followed_twin(FISH)
    exact = [name for name in IN_WATER.unknown if name.startswith(("twin.", "water."))]
    known = replace(
        OURS,
        imitated={**OURS.imitated, "error.surge_0": 0.015},
        unknown={**OURS.unknown, **dict.fromkeys(exact, 1e-4), "error.surge_0": 0.03},
    )
    references = [slower(swum({}, seed=k), 0.03) for k in (1, 2)]
    prior = learned(references, servos(), FISH, simulate, known)
    fresh = slower(swum({}, seed=3), 0.03)
    problem = SwimProblem(Coordinates.of(FISH, servos()), [fresh], simulate, prior)
    x = problem.centre(frozenset())
    (said,) = signals_at(problem.coordinates, fresh, x[None], simulate)
    assert said[:, 0].mean() == pytest.approx(fresh.signals[:, 0].mean(), rel=0.015)
    assert problem.coordinates.seems[problem.coordinates.place["error.surge_0"]] < -0.015
    model = problem.coordinates.model_at(x)
    write_model(model, tmp_path / "model.json")
    (kept,) = signals_of([read_model(tmp_path / "model.json")], fresh, simulate)
    np.testing.assert_allclose(kept, said, atol=1e-6)


def test_an_error_that_is_usual_is_no_evidence():
    """A swim that is slower by one usual error is none of drag, where its robot is not."""
    simulate = by_followed_twin(FISH)
    own = IN_WATER.imitated["error.surge_0"]
    references = [swum({}, seed=k) for k in (1, 2)]
    prior = learned(references, servos(), FISH, simulate, OURS)

    def evidence(share):
        swim = slower(swum({}, seed=3), share)
        found = searched(SwimProblem(Coordinates.of(FISH, servos()), [swim], simulate, prior))
        gain = found.best.evidence - found.plain.evidence
        return gain + COST * len(found.best.members)

    assert evidence(own) < 6.0
    assert evidence(12 * own) > 12.0


def robots(rng, own, common, usual, count=40, swims=6):
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


def test_what_robots_differ_by_and_what_their_swims_do_are_told_apart():
    own, common, usual = 0.05, 0.2, 0.4
    given = robots(np.random.default_rng(0), own, common, usual)
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


def test_what_was_known_of_robots_counts():
    few = robots(np.random.default_rng(1), 0.05, 0.2, 0.0, count=2)
    begun = (
        np.full((4, 3), 0.01), {"error.surge_0": 0.05},
        {"twin.across": 1.0, "error.surge_0": 0.2}, {"twin.across": 0.0},
    )  # fmt: skip
    free, held = begun, begun
    for _ in range(20):
        free = learning.sizes(few, free, {})
        held = learning.sizes(few, held, {"twin.across": 1.0})
    assert held[2]["twin.across"] > 3 * free[2]["twin.across"]
