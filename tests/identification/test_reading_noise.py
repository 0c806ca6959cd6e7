"""Readings that are left out, noise that grows with speed, and clocks that run apart."""

from dataclasses import replace

import numpy as np
import pytest
from simulated import KP, NOISE, recording, robot, row, traced

from sim2real.diagnose.case import Case, JointCase, batch_of, on_one_clock, prepared
from sim2real.diagnose.servo_search import ServoSearch, baselines, plain_sets
from sim2real.identification.identify import identify
from sim2real.identification.problem import ServoProblem
from sim2real.identification.reading_noise import (
    jitter_s,
    left_out,
    rest_noise,
    with_reading_noise,
    without_releases,
)
from sim2real.identification.search import errors_of
from sim2real.servo.batch import Batch
from sim2real.servo.trace import fit_noise

JITTER_S = 2.5e-3


@pytest.fixture(scope="module")
def usual():
    return traced(1, "a")


def fast(jitter_s):
    """A joint that is read every 10 ms, at rest in part and turning up to 6 rad/s in part."""
    t, rng = np.arange(0.0, 12.0, 0.01), np.random.default_rng(5)

    def angle(t):
        return np.sin(0.5 * np.maximum(t - 4, 0) ** 1.7)

    read = angle(t + jitter_s * rng.standard_normal(t.size)) + rng.normal(0, 1e-3, t.size)
    used = np.ones(t.size, dtype=bool)
    return replace(traced(1, "a"), t=t, command=angle(t), position=read, used=used)


def test_a_sensor_that_is_read_in_time_has_one_noise(usual):
    for trace in (usual, fast(0.0)):
        (kept,) = with_reading_noise([trace])
        assert kept.spread is None
        assert list(left_out([kept])) == []
    assert rest_noise([usual]) == pytest.approx(NOISE, rel=0.3)


def test_times_that_vary_are_noise_that_grows_with_speed():
    (kept,) = with_reading_noise([fast(JITTER_S)])
    found, rest = jitter_s([kept])
    assert found == pytest.approx(JITTER_S, rel=0.3)
    assert rest == pytest.approx(1e-3, rel=0.3)
    assert kept.spread.min() == pytest.approx(1.0, abs=0.2)
    assert kept.spread.max() > 5
    assert "times vary by" in next(iter(left_out([kept])))


def test_fits_weight_readings_by_their_noise_and_the_usual_errors_of_a_law(usual):
    (kept,) = with_reading_noise([fast(JITTER_S)], slow=True)
    (plain,), servo = errors_of(row(), [kept]), ServoProblem([kept], row(), ())
    assert servo.row_residuals(row()[None])[0] * kept.fit_ratio == pytest.approx(plain)
    assert np.ptp(kept.fit_ratio) > 3
    assert fit_noise([kept]) < 0.5 * rest_noise([kept])
    (same,) = with_reading_noise([usual], slow=True)
    assert (same.fit_ratio == 1).all()


def test_wrong_readings_are_left_out_and_said(usual):
    position = usual.position.copy()
    position[[100, 300]] += 3.0
    (kept,) = with_reading_noise([replace(usual, position=position)])
    assert np.flatnonzero(~kept.used).tolist() == [100, 300]
    (said,) = left_out([kept])
    assert "2 readings of a left out" in said


def test_a_release_is_left_out_and_a_slow_servo_is_not(usual):
    moving = np.flatnonzero(np.abs(np.diff(usual.command)) > 0)[0]
    hanging = usual.position.copy()
    hanging[moving:] = usual.position[moving]
    away = np.abs(usual.position - hanging)
    released = replace(usual, position=hanging)
    kept = without_releases(released, usual.position, least_rad=0.5 * float(away.max()))
    assert (~kept.used).any()
    assert "left out from" in next(iter(left_out([kept])))
    assert without_releases(usual, usual.position + 0.01) is usual


def test_identify_leaves_out_releases_and_says_when():
    whole = recording(1, "a", seconds=8.0)
    position = whole.position.copy()
    for since, until in ((2.0, 3.0), (6.5, 9.0)):  # the second until the end
        hangs = (whole.t >= since) & (whole.t < until)
        position[hangs] = position[hangs][0]
    servo = identify([replace(whole, position=position)], robot("j1")).joints["j1"]
    assert servo.kp_Nm_per_rad == pytest.approx(KP, rel=0.02)
    assert any("a left out from 2.0" in note and "and from 6.6" in note for note in servo.notes)


QUIET = 1e-5


def moved(drifts):
    """By how much recordings whose clocks run apart so much were moved, and should be, rad."""
    given = [
        traced(k, f"r{k}", seconds=30.0, noise=QUIET, clock_drift={"s_per_s": drift})
        for k, drift in enumerate(drifts)
    ]
    still = [traced(k, f"r{k}", seconds=30.0, noise=QUIET) for k, _ in enumerate(drifts)]
    batch = Batch([given])
    best = [one.best for one in plain_sets(baselines(batch))]
    (joint,) = on_one_clock(batch, [JointCase("j1", given, QUIET, None)], best)
    now = [a.position - b.position for a, b in zip(joint.traces, given, strict=True)]
    right = [a.position - b.position for a, b in zip(still, given, strict=True)]
    return np.concatenate(now), np.concatenate(right)


def test_each_recording_has_a_drift_of_its_own():
    now, right = moved((20e-6, -15e-6))
    assert np.std(right) > 10 * QUIET
    assert np.std(now - right) < 0.3 * np.std(right)


def test_clocks_that_run_apart_are_left_alone():
    now, _ = moved((3e-4, 3e-4))
    assert not now.any()


@pytest.mark.parametrize("every, polled", [(1, False), (5, True)])
def test_the_age_of_polled_readings_slips_as_clocks_that_run_apart_do(every, polled):
    whole = recording(1)
    thinned = {name: getattr(whole, name)[::every] for name in ("t", "command", "position")}
    (joint,) = prepared(Case([replace(whole, **thinned)], robot("j1")))
    assert (joint.traces[0].slow is not None) == polled
    batch = batch_of([joint])
    (tried,) = plain_sets(baselines(batch))
    search = ServoSearch(batch, [joint], 0.01, np.random.default_rng(0))
    _, options = search.seen(tried, frozenset())
    assert ("clock_drift" not in {one.effect.name for one in options}) == polled
