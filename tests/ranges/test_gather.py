"""Ranges from recordings made by the paper's own table, and from a bench."""

from dataclasses import replace

import numpy as np
import pytest
import simulated

from benchmarks import paper_table as paper
from sim2real.errors import InputError
from sim2real.model import FittedEffect, JointModel, Model
from sim2real.ranges.entry import read_ranges, write_ranges
from sim2real.ranges.gather import Sampling, gather
from sim2real.recording import Load
from sim2real.robot import Joint, Link, Robot, Servo

LINK = Link("head", 0.5, 0.2, 0.1, 0.1, mass_sd_kg=0.01)
ROBOT = Robot(
    "one", (LINK, replace(LINK, name="tail")), (Joint("j1", Servo("s", 1, 5, 0.0), (-1, 1)),)
)
JOINT = JointModel(
    simulated.KP, simulated.KD, simulated.LATENCY, simulated.INERTIA, load=Load(simulated.INERTIA)
)
SAMPLING = Sampling(steps=300, walkers=16)


@pytest.fixture(scope="module")
def bench():
    return [simulated.recording(k, f"r{k}") for k in range(3)]


@pytest.fixture(scope="module")
def found(bench):
    return gather(bench, ROBOT, Model({"j1": JOINT}), SAMPLING)


def test_the_papers_table_comes_back(monkeypatch):
    monkeypatch.setattr(paper, "SECONDS", 15.0)
    recordings, latency = paper.episodes(np.random.default_rng(2))
    ratios = paper.compared(gather(recordings, paper.ROBOT, paper.MODEL).ranges)
    assert len(ratios) == 7
    assert np.ptp(latency) == pytest.approx(0.040, rel=0.05)  # these draws are no freak
    for name, ratio in ratios.items():
        assert ratio == pytest.approx(1.0, abs=0.1), name


def test_gains_lie_between_quantiles_of_the_posterior_and_density_by_the_scales_errors(found):
    kp = found.ranges.named("j1.kp_Nm_per_rad")
    low, high = np.quantile(found.posteriors["j1"].values[:, 0], [0.05, 0.95])
    assert (kp.first, kp.second) == pytest.approx((low, high))
    assert kp.first < 1.01 * simulated.KP and kp.second > 0.99 * simulated.KP
    assert "r0, r1, r2: 5 % and 95 % quantiles" in kp.source and kp.period == "episode"
    head = found.ranges.named("body.normalised_density.head")
    assert head.first == pytest.approx(1.0) and head.second == pytest.approx(0.01 * np.sqrt(2))


def test_the_probability_of_the_ranges_is_stated(bench, found, tmp_path):
    half = gather(bench, ROBOT, Model({"j1": JOINT}), replace(SAMPLING, level=0.5)).ranges
    write_ranges(half, tmp_path / "ranges.json")
    assert read_ranges(tmp_path / "ranges.json").interval_level == 0.5
    kp = half.named("j1.kp_Nm_per_rad")
    values = found.posteriors["j1"].values[:, 0]
    assert (kp.first, kp.second) == pytest.approx(np.quantile(values, [0.25, 0.75]))
    assert "25 % and 75 % quantiles" in kp.source and found.ranges.interval_level == 0.9


def test_all_recordings_are_sampled_and_one_is_checked_on_a_bench_without_links(bench, found):
    bare = Robot("one", (Link("a"), Link("b")), (Joint("j1", Servo("s")),))
    again = gather(bench, bare, Model({"j1": JOINT}), replace(SAMPLING, held_out="r0"))
    for gathered, checked in ((found, "r2"), (again, "r0")):
        assert [t.name for t in gathered.posteriors["j1"].problem.traces] == ["r0", "r1", "r2"]
        assert gathered.checks["j1"].recording == checked
    assert again.density is None
    kept = [e for e in found.ranges.entries if "density" not in e.parameter]
    assert list(again.ranges.entries) == kept


def test_a_pool_alone_takes_gains_from_the_model(bench):
    swum = [replace(r, kind="pool", loads={}) for r in bench]
    joint = replace(JOINT, interval={"kp_Nm_per_rad": (2.1, 2.3), "kd_Nms_per_rad": (0.05, np.inf)})
    body = {
        "effects": [{"effect": "form_drag", "parameters": {"coefficient": 0.3}}],
        "interval": {"form_drag.coefficient": [0.2, 0.5]},
    }
    ranges = gather(swum, ROBOT, Model({"j1": joint}, body)).ranges
    kp, kd = (ranges.named(f"j1.{n}") for n in ("kp_Nm_per_rad", "kd_Nms_per_rad"))
    drag = ranges.named("body.form_drag.coefficient")
    assert (kp.first, kp.second) == (2.1, 2.3)
    assert (kd.first, kd.second) == (0.05, simulated.KD) and "open end" in kd.source
    assert (drag.first, drag.second) == (0.2, 0.5)
    assert any("gains are those of the model" in note for note in ranges.notes)


def test_every_effect_of_the_model_has_a_range():
    effects = (
        FittedEffect("coulomb_friction", {"torque_Nm": 0.04}),
        FittedEffect("latency_jitter", {"halfwidth_s": 0.005}),
    )
    sag = FittedEffect("voltage_sag", {"loss_at_full_load": 0.2})
    model = Model({"j1": replace(JOINT, effects=effects)}, effects=(sag,))
    rubbing = simulated.recording(seconds=8.0, coulomb_friction={"torque_Nm": 0.05})
    ranges = gather([rubbing], ROBOT, model, Sampling(steps=250)).ranges
    friction = ranges.named("j1.coulomb_friction.torque_Nm")
    assert 0.045 < friction.first < friction.second < 0.055 and "posterior" in friction.source
    jitter = ranges.named("j1.latency_jitter.halfwidth_s")
    assert jitter.first == jitter.second == 0.005 and "no interval" in jitter.source
    loss = ranges.named("voltage_sag.loss_at_full_load")
    assert loss.first == 0.2 and loss.unit == ""


def test_every_parameter_of_a_motor_has_a_range_or_a_line(bench):
    motor = {"stall_torque_Nm": 1.5, "no_load_speed_rad_s": 8.0, "coulomb_Nm": 0.02}
    motor |= {"load_friction": 1e-9, "rotor_inertia_kgm2": 1e-4}
    interval = {
        "motor.stall_torque_Nm": (1.3, 1.7),
        "motor.coulomb_Nm": (0.01, 0.03),
        "motor.no_load_speed_rad_s": (7.0, np.inf),
        "motor.load_friction": (0.0, 0.7),
        "motor.resistance_rise": (0.0, 0.005),
    }
    joint = replace(JOINT, law="motor", motor=motor, interval=interval)
    swum = [replace(r, kind="pool", loads={}) for r in bench]
    ranges = gather(swum, ROBOT, Model({"j1": joint})).ranges
    stall, speed, coulomb, load, rotor = (ranges.named(f"j1.motor.{name}") for name in motor)
    assert (stall.first, stall.second, stall.unit) == (1.3, 1.7, "N m")
    assert (coulomb.first, coulomb.second) == (0.01, 0.03) and "90 % interval" in coulomb.source
    assert (speed.first, speed.second) == (7.0, 8.0) and "open end" in speed.source
    assert rotor.constant and "no interval" in rotor.source
    assert load is None
    (note,) = [note for note in ranges.notes if "no range" in note and note.startswith("j1")]
    assert "motor.load_friction (to 0.7)" in note and "motor.resistance_rise (to 0.005)" in note


def test_what_recordings_do_not_determine_does_not_stop_it():
    """A limit of the torque that no recording reaches is not sampled."""
    limit = FittedEffect("torque_saturation", {"limit_Nm": 15.0, "free_damping": 1.0})
    friction = FittedEffect("coulomb_friction", {"torque_Nm": 0.04})
    interval = {"torque_saturation.limit_Nm": (12.0, 18.0)}
    joint = replace(JOINT, effects=(limit, friction), interval=interval)
    rubbing = [simulated.recording(seconds=8.0, coulomb_friction={"torque_Nm": 0.05})]
    found = gather(rubbing, ROBOT, Model({"j1": joint}), Sampling(steps=350))
    posterior = found.posteriors["j1"]
    assert posterior.undetermined == tuple(f"torque_saturation.{name}" for name in limit.parameters)
    assert "coulomb_friction.torque_Nm" in posterior.names
    entry = found.ranges.named("j1.torque_saturation.limit_Nm")
    assert (entry.first, entry.second) == (12.0, 18.0) and "model" in entry.source
    assert any("do not determine torque_saturation.limit_Nm" in x for x in found.ranges.notes)


def test_missing_physics_is_said():
    how = {"backlash": {"gap_rad": 0.06}, "noise": 5e-4}
    loose = [simulated.recording(k, f"r{k}", **how) for k in range(2)]
    notes = gather(loose, ROBOT, Model({"j1": JOINT}), SAMPLING).ranges.notes
    assert any("physics is missing" in note for note in notes)


@pytest.mark.parametrize(
    ("chosen", "joint", "sampling", "message"),
    [
        ([0, 0], "j1", SAMPLING, "each recording once"),
        ([0, 1, 2], "j9", SAMPLING, "a joint not of the robot"),
        ([0, 1, 2], "j1", Sampling(held_out="x"), "--held-out: found 'x'"),
    ],
)
def test_what_does_not_fit_together(bench, chosen, joint, sampling, message):
    with pytest.raises(InputError, match=message):
        gather([bench[k] for k in chosen], ROBOT, Model({joint: JOINT}), sampling)
