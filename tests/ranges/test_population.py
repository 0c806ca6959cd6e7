"""Ranges of a type of servo from models of several units, and the latencies of recordings."""

from dataclasses import replace

import numpy as np
import pytest
import simulated
from good_input import message
from scipy.stats import chi2, t

import sim2real as s2r
from sim2real.inference.variance_components import variance_components
from sim2real.model import FittedEffect, JointModel, Model, write_model
from sim2real.ranges.latency import latencies, spread
from sim2real.recording import Load

KP, KD = "kp_Nm_per_rad", "kd_Nms_per_rad"


def test_without_errors_the_distributions_are_those_of_student_and_of_chi_squared():
    values = np.array([1.0, 1.3, 0.9, 1.2, 1.15])
    found = variance_components(values, np.zeros(5), "abcde", points=200)
    student, middle, sd = t.ppf([0.05, 0.5, 0.95], 4), values.mean(), values.std(ddof=1)
    assert found.new == pytest.approx(middle + student * sd * np.sqrt(1 + 1 / 5), rel=1e-3)
    assert found.mean == pytest.approx(middle + student * sd / np.sqrt(5), rel=1e-3)
    spread = sd * np.sqrt(4 / chi2.ppf([0.95, 0.5, 0.05], 4))
    assert found.between == pytest.approx(spread, rel=0.02) and found.within is None
    runs = variance_components(values, np.zeros(5), "aaaaa", points=200)
    assert runs.within == found.between and runs.between is None and runs.new == found.new


@pytest.mark.parametrize(
    ("units", "runs", "between", "within"), [(6, 1, 0.1, 0.0), (5, 2, 0.1, 0.04)]
)
def test_intervals_hold_the_truth_and_ranges_a_new_unit(units, runs, between, within):
    rng, inside = np.random.default_rng(units), []
    for _ in range(150):
        unit = np.repeat(np.arange(units), runs)
        sd = 0.01 * np.exp(rng.normal(0, 0.3, unit.size))
        true = rng.normal(0, between, units)[unit] + rng.normal(0, within, unit.size)
        found = variance_components(rng.normal(true, sd), sd, unit.tolist())
        new = rng.normal(0, np.hypot(between, within))
        pairs = [(found.mean, 0.0), (found.new, new), (found.between, between)]
        pairs += [(found.within, within)] if found.within else []
        inside.append([low <= value <= high for (low, _, high), value in pairs])
    mean, range_, *spreads = np.mean(inside, axis=0)
    assert [mean, range_] == pytest.approx([0.9] * 2, abs=0.05)
    assert spreads == pytest.approx([0.92] * len(spreads), abs=0.05)


def servo(kp, gain=None, **changes):
    interval = {KP: (0.99 * kp, 1.01 * kp), KD: (0.04, 0.06), "latency_s": (0.0, 0.03)}
    joint = JointModel(kp, 0.05, 0.02, 0.01, interval=interval)
    return Model({"j1": replace(joint, **changes)}, firmware_p_gain=gain)


def test_units_at_other_firmware_gains_are_one_population(tmp_path):
    models = {f"u{k}": servo(kp * gain, gain) for k, (kp, gain) in enumerate(
        [(0.1, 16), (0.11, 32), (0.095, 16), (0.105, 8)])}  # fmt: skip
    for name, model in models.items():
        write_model(model, tmp_path / f"{name}.json")
    found = s2r.ranges(population=[tmp_path / f"{name}.json" for name in models])
    kp = found.ranges.named(f"j1.{KP}")
    assert 1.2 < kp.first < 1.6 < kp.second < 2.1 and "4 models of 4 units" in kp.source
    assert found.ranges.named("command_latency_s").first == 0.0
    assert any("kp is that of the firmware gain 16" in note for note in found.ranges.notes)
    assert "j1 kp" in str(found) and found.plot().axes[0].get_title("left") == "kp, N m/rad"
    runs = s2r.ranges(population={"one": list(models.values())[:3]})
    assert runs.ranges.named(f"j1.{KP}").first == pytest.approx(
        s2r.ranges(population=list(models.values())[:3]).ranges.named(f"j1.{KP}").first
    )
    assert any("other units" in note for note in runs.ranges.notes)


def test_values_of_a_prior_are_no_evidence_of_a_small_spread():
    motor = {"stall_torque_Nm": 1.5, "no_load_speed_rad_s": 8.0}
    ends = {KP: (1.9, 2.1), "motor.stall_torque_Nm": (1.0, 2.2)}
    law = {"law": "motor", "motor": motor, "interval": ends}
    blind = [servo(2.0, by_prior=("motor.stall_torque_Nm",), **law) for _ in range(4)]
    stall = s2r.ranges(population=blind).ranges.named("j1.motor.stall_torque_Nm")
    assert (stall.first, stall.second) == (1.0, 2.2) and "less than two" in stall.source


def test_what_is_no_population_is_one_line():
    message(lambda: s2r.ranges(population=[servo(1.0)]), "--population", "1 of them", "two models")
    both = [servo(1.0), servo(1.0, per_inertia=True)]
    message(lambda: s2r.ranges(population=both), "joints.j1", "per unit of inertia")
    message(lambda: s2r.ranges([], None, servo(1.0)), "--robot", "nothing", "--population")


JOINT = JointModel(
    1.2 * simulated.KP, 0.8 * simulated.KD, 0.03, simulated.INERTIA, load=Load(simulated.INERTIA)
)
MODEL = Model({"j1": JOINT})


def early(recording, by):
    """The recording, its set-points logged ``by`` samples before they were sent."""
    moved = np.concatenate([recording.command[by:], np.repeat(recording.command[-1:], by, axis=0)])
    return replace(recording, command=moved)


@pytest.fixture(scope="module")
def recordings():
    return [early(simulated.recording(k, f"r{k}", seconds=6.0), k % 3) for k in range(6)]


def test_each_recording_has_its_own(recordings):
    """Set-points logged one sample (20 ms) early make the latency so much longer."""
    estimate = latencies(recordings, MODEL)
    expected = simulated.LATENCY + simulated.PERIOD * np.array([0, 1, 2, 0, 1, 2])
    assert estimate.episodes == [f"r{k}" for k in range(6)] and not estimate.windows
    np.testing.assert_allclose(estimate.seconds, expected, atol=1e-3)
    assert (np.abs(estimate.seconds - expected) < 4 * estimate.sd + 1e-4).all()


def test_few_recordings_are_cut_into_windows():
    estimate = latencies([simulated.recording(0, seconds=18.0)], MODEL)
    assert estimate.windows and len(estimate.episodes) == 3
    np.testing.assert_allclose(estimate.seconds, simulated.LATENCY, atol=1e-3)


def test_a_load_that_is_not_stated_is_no_hindrance(recordings):
    swimming = [replace(r, kind="pool", loads={}) for r in recordings]
    estimate = latencies(swimming, MODEL)
    np.testing.assert_allclose(estimate.seconds, latencies(recordings, MODEL).seconds, atol=1e-4)


def test_what_the_model_knows_is_not_taken_for_latency():
    gap = {"backlash": {"gap_rad": 0.02}}
    recordings = [simulated.recording(k, f"r{k}", seconds=6.0, **gap) for k in range(5)]
    effect = FittedEffect("backlash", gap["backlash"])
    estimate = latencies(recordings, Model({"j1": replace(JOINT, effects=(effect,))}))
    np.testing.assert_allclose(estimate.seconds, simulated.LATENCY, atol=2e-4)


def test_joints_differ():
    a, b = (simulated.recording(k, "both", seconds=18.0) for k in (0, 1))
    both = simulated.beside(a, early(b, 1))
    estimate = latencies([both], Model({"j1": JOINT, "j2": JOINT}))
    np.testing.assert_allclose(estimate.seconds, simulated.LATENCY + 0.01, atol=1e-3)
    assert estimate.offset["j1"][0] == pytest.approx(-0.01, abs=1e-3)
    assert estimate.offset["j2"][0] == pytest.approx(0.01, abs=1e-3)


def test_nothing_moves():
    still = simulated.recording(0, command=np.zeros_like)
    assert latencies([still], MODEL) is None


@pytest.mark.parametrize("error", [1e-4, 5e-3])
def test_errors_are_not_counted_as_spread(error):
    """Over many sets, neither the half-width nor the centre is off on average."""
    half, centre = [], []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        latencies = rng.uniform(0.048, 0.088, 40) + error * rng.standard_normal(40)
        estimate = spread(latencies, np.full(40, error))
        half.append(estimate.half_width)
        centre.append(estimate.centre)
    assert np.mean(half) == pytest.approx(0.020, rel=0.03)
    assert np.mean(centre) == pytest.approx(0.068, rel=0.01)


def test_its_interval_holds_the_truth_as_often_as_it_says():
    inside = 0
    for seed in range(100):
        rng = np.random.default_rng(seed)
        latencies = rng.uniform(0.048, 0.088, 12) + 5e-4 * rng.standard_normal(12)
        low, high = spread(latencies, np.full(12, 5e-4)).half_width_90
        inside += low <= 0.020 <= high
    assert 83 <= inside <= 97


def test_one_latency_leaves_the_spread_open():
    estimate = spread(np.array([0.06]), np.array([1e-3]))
    assert estimate.centre == pytest.approx(0.06, abs=1e-3)
    assert estimate.half_width_90[1] > 5 * estimate.half_width_90[0]
