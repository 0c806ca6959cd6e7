"""Drag that the robot file leaves out, from mean speeds and yaw rates."""

from dataclasses import replace

import numpy as np
from swimming_robots import FISH, servos

from sim.inference.law_error import LAW_ERROR
from sim.inference.resistance import (
    AREA,
    PLACE,
    figures,
    from_figures,
    grid_of,
    resistance,
    with_resistance,
)
from sim.inference.swims import Swim, by_twin, simulated, with_values
from sim2real.diagnose.result import Diagnosis

PERIOD_S, SECONDS = 0.02, 5.0
PLAIN = replace(servos(), body={})
SIMULATOR = by_twin(FISH, threads=1)


def swims(model):
    """Two gaits of the fish in the twin."""
    out = []
    for hz, size in ((1.0, 0.4), (1.8, 0.3)):
        t = PERIOD_S * np.arange(round(SECONDS / PERIOD_S))
        command = size * np.sin(2 * np.pi * hz * t[:, None] - np.array([0.0, 1.0, 2.0]))
        blank = Swim(f"{hz} Hz", t, command, np.zeros(3), np.empty((t.size, 0)))
        (seen,) = simulated(blank, [model], SIMULATOR)
        out.append(replace(blank, signals=seen))
    return out


def signals(models, swim):
    return simulated(swim, models, SIMULATOR)


def diagnosis():
    """A search that named nothing."""
    none = {}
    return Diagnosis(
        verdict="unexplained", mismatch=(), effects=(), rivals=(), unknown={}, baseline_fit=none,
        enriched_fit=none, detection_limits=(), next_experiment=None, gate=(),
        model=servos(), baseline=servos(),
    )  # fmt: skip


def test_an_area_is_found_and_helps_swims_left_out():
    there = with_values(PLAIN, {AREA: 0.04, PLACE: 0.1})
    found = resistance(swims(there), PLAIN, FISH, signals)
    assert found.area.q05 < 0.04 < found.area.q95
    assert found.area.q95 < 0.12
    assert found.log_odds > LAW_ERROR.decisions["resistance"]
    before, after = found.left_out
    assert np.all(after < 0.4 * before)
    told = with_resistance(diagnosis(), found, LAW_ERROR.decisions)
    assert told.verdict == "partly_explained"
    assert "drag area" in told.effects[0].statement
    assert " cm² (90 %: " in told.effects[0].statement


def test_nothing_is_named_where_nothing_resists():
    found = resistance(swims(PLAIN), PLAIN, FISH, signals)
    assert found.log_odds < 0
    plain = diagnosis()
    assert with_resistance(plain, found, LAW_ERROR.decisions) is plain


def test_a_simulator_that_is_equally_off_in_all_swims_is_no_proof():
    """A fifth too fast is what robots differ by; three times too fast is not."""
    grid = grid_of(FISH, areas=5, places=1)
    measured = np.array([[0.1, 1.0], [0.2, 2.0], [0.3, 2.5]])
    slower = (1 / (1 + 40 * grid[:, 0]))[:, None, None]

    def odds(ratio):
        said = (
            measured
            * np.array([ratio, 1.0])
            * np.concatenate([slower, np.ones_like(slower)], axis=2)
        )
        return from_figures(measured, said, grid).log_odds

    assert odds(1.2) < 2.0 < 6.0 < odds(3.0)


def test_figures_ignore_a_steady_turn():
    t = np.arange(100)
    turning = np.stack([np.full(100, 0.2), 0 * t, 0.5 + np.sin(2 * np.pi * t / 50)], axis=1)
    assert np.allclose(figures(turning), [0.2, np.sqrt(0.5)])
