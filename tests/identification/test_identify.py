"""The fit: known servos come back, what is not known is said, and nothing is scored on itself."""

import importlib.util
import json
import sys
from pathlib import Path

import numpy as np
import pytest

from sim2real.errors import InputError
from sim2real.identification.identify import identify
from sim2real.recording import Load, Recording, read_recording
from sim2real.robot import Joint, Link, Robot, Servo, read_robot
from sim2real.servo.prediction import predict, replay

DATA = Path(__file__).parents[2] / "datasets" / "servo_steps"
NAMES = ("kp_Nm_per_rad", "kd_Nms_per_rad", "latency_s")

spec = importlib.util.spec_from_file_location("servo_steps_make", DATA / "make.py")
plant = sys.modules["servo_steps_make"] = importlib.util.module_from_spec(spec)
spec.loader.exec_module(plant)


def bench(*joints):
    link = Link("link", 0.1, 0.1, 0.1, 0.1)
    servo = Servo("lx824", 1.67, 5.24, 0.00419)
    links = (link,) * (len(joints) + 1)
    return Robot("bench", links, tuple(Joint(name, servo, (-1.0, 1.0)) for name in joints))


def record(servo, command=None, *, seed=0, loads=True, name="steps", t=None, noise=0.0015):
    """One joint, made by the data set's own plant."""
    rng = np.random.default_rng(seed)
    t = np.arange(0, 20, 0.02) if t is None else t
    command = plant.steps(t - 0.5, rng) * (t > 0.5) if command is None else command
    angle = plant.simulate(servo, t, t, command)[:, 0] + rng.normal(0, noise, t.size)
    given = {"j1": Load(servo.inertia_kgm2)} if loads else {}
    return Recording(name, "servo", ("j1",), t, command[:, None], angle[:, None], given)


SERVO = plant.Servo(2.2, 0.06, 0.0683, 0.002)
HALF = np.arange(0, 10, 0.02)
"""Times of a recording for fits that no servo suits, which take long."""


@pytest.fixture(scope="module")
def shipped():
    names = ("steps", "square", "sine", "chirp")
    recordings = [read_recording(DATA / f"{name}.csv") for name in names]
    return recordings, identify(recordings, read_robot(DATA / "robot.toml"))


@pytest.fixture(scope="module")
def fitted():
    return identify([record(SERVO)], bench("j1"))


def test_shipped_servos_are_recovered(shipped):
    _, model = shipped
    truth = json.loads((DATA / "truth.json").read_text())["joints"]
    for joint, servo in model.joints.items():
        for name in NAMES:
            assert getattr(servo, name) == pytest.approx(truth[joint][name], rel=0.01)
            low, high = servo.interval[name]
            assert low < getattr(servo, name) < high
        assert servo.notes == ()


def test_residual_is_noise_on_what_was_held_out(shipped):
    _, model = shipped
    assert set(model.provenance["held_out"].values()) == {"chirp"}
    for figures in model.fit.values():
        assert figures["heldout"] == pytest.approx(figures["noise"], rel=0.2)
        assert abs(figures["whiteness"]) < 0.1


def test_replay_marks_what_the_fit_did_not_see(shipped):
    recordings, model = shipped
    for one in replay(model, recordings):
        assert one.held_out.any() == (one.recording.name == "chirp")
        error = one.predicted - one.recording.position[:, one.recording.joints.index(one.joint)]
        assert np.nanstd(error) < 0.0025


def test_same_seed_same_model(fitted):
    again = identify([record(SERVO)], bench("j1"))
    assert again.joints == fitted.joints


def test_held_out_samples_do_not_touch_the_fit_that_is_scored(fitted):
    recording = record(SERVO)
    spoiled = recording.position.copy()
    spoiled[800:] += 0.1  # after the last three quarters
    other = Recording(**{**vars(recording), "position": spoiled})
    fits = [identify([one], bench("j1"), refit=False) for one in (recording, other)]
    assert fits[0].joints["j1"].interval == fits[1].joints["j1"].interval
    assert fits[1].fit["j1.position_rad"]["heldout"] > 0.05
    assert fitted.fit["j1.position_rad"]["heldout"] == fits[0].fit["j1.position_rad"]["heldout"]


def test_the_model_is_fitted_to_what_was_held_out_once_it_is_scored(fitted):
    without = identify([record(SERVO)], bench("j1"), refit=False).joints["j1"]
    for name in NAMES:
        ends = without.interval[name], fitted.joints["j1"].interval[name]
        assert np.ptp(ends[1]) < np.ptp(ends[0])


def test_outliers_do_not_move_the_fit(fitted):
    clean = record(SERVO)
    spoiled = clean.position.copy()
    rng = np.random.default_rng(1)
    spoiled[rng.choice(spoiled.size, 20, replace=False)] += rng.choice([-2.0, 1.5], (20, 1))
    other = Recording(**{**vars(clean), "position": spoiled})
    fits = [fitted.joints["j1"], identify([other], bench("j1")).joints["j1"]]
    for name in NAMES:
        assert getattr(fits[1], name) == pytest.approx(getattr(fits[0], name), rel=0.01)


def test_load_not_known_gives_gains_per_inertia():
    model = identify([record(SERVO, loads=False)], bench("j1")).joints["j1"]
    assert model.per_inertia
    assert model.inertia_kgm2 == 1.0
    assert model.kp_Nm_per_rad == pytest.approx(2.2 / 0.002, rel=0.02)
    assert model.kd_Nms_per_rad == pytest.approx(0.06 / 0.002, rel=0.02)


def test_missing_samples_and_a_gap():
    recording = record(SERVO)
    position = recording.position.copy()
    position[::7] = np.nan
    keep = np.ones(recording.t.size, dtype=bool)
    keep[400:404] = False
    thinned = Recording(
        "steps", "servo", ("j1",), recording.t[keep], recording.command[keep], position[keep],
        recording.loads,
    )  # fmt: skip
    model = identify([thinned], bench("j1")).joints["j1"]
    # set-points sent in the gap are lost with it, so the tolerance is wider than without
    assert model.kp_Nm_per_rad == pytest.approx(2.2, rel=0.03)


def test_slow_motion_leaves_directions_open_and_says_so():
    t = np.arange(0, 20, 0.02)
    crawl = 0.3 * np.sin(0.05 * 2 * np.pi * t)
    model = identify([record(SERVO, crawl)], bench("j1")).joints["j1"]
    reasons = ("do not constrain", "no influence", "cannot be determined", "another optimum")
    assert any(reason in note for note in model.notes for reason in reasons)
    low, high = model.interval["kp_Nm_per_rad"]
    assert low < 2.2 < high
    assert high > 20 * low


def pendulum(extra):
    """A servo whose load leaves out ``extra``, simulated by scipy."""
    from scipy.integrate import solve_ivp

    kp, kd, inertia, gravity = 0.5, 0.03, 0.0049 + extra, 0.49 * 9.80665 * 0.1
    t = np.arange(0, 12, 0.005)

    def sent(x):
        return np.sin((x - 0.002) ** 2 / 2) if x > 0.002 else 0.0

    def slope(x, y):
        return [y[1], (kp * (sent(x) - y[0]) - kd * y[1] - gravity * np.sin(y[0])) / inertia]

    angle = solve_ivp(slope, (0, 12), [0, 0], t_eval=t, max_step=0.005, rtol=1e-9, atol=1e-11).y[0]
    noisy = angle + np.random.default_rng(0).normal(0, 0.001, t.size)
    command = np.array([sent(x + 0.002) for x in t])
    return Recording(
        "swing", "servo", ("j1",), t, command[:, None], noisy[:, None],
        {"j1": Load(0.0049, 0.49, 0.1)},
    )  # fmt: skip


def test_incomplete_load_is_noticed_and_can_be_fitted():
    recording = pendulum(extra=0.0017)
    held = identify([recording], bench("j1"), law="pd").joints["j1"]
    assert any("contradict the stated inertia" in note for note in held.notes)
    freed = identify([recording], bench("j1"), effects=["unmodelled_inertia"]).joints["j1"]
    (effect,) = freed.effects
    assert effect.parameters["inertia_kgm2"] == pytest.approx(0.0017, rel=0.05)
    assert freed.latency_s < 0.006
    assert held.latency_s - freed.latency_s > 0.005, "held inertia invents latency"


def test_complete_load_is_not_accused():
    model = identify([pendulum(extra=0.0)], bench("j1")).joints["j1"]
    assert not any("contradict" in note for note in model.notes)


def test_two_known_loads_show_a_rotor_without_a_pendulum():
    light, heavy = (plant.Servo(2.2, 0.06, 0.0683, inertia + 0.001) for inertia in (0.002, 0.006))
    recordings = [record(light, name="light"), record(heavy, name="heavy", seed=1)]
    stated = [Load(0.002), Load(0.006)]
    given = [Recording(**{**vars(r), "loads": {"j1": load}})
             for r, load in zip(recordings, stated, strict=True)]  # fmt: skip
    given.append(Recording(**{**vars(given[0]), "name": "again"}))
    model = identify(given, bench("j1"), effects=["unmodelled_inertia"]).joints["j1"]
    assert model.effects[0].parameters["inertia_kgm2"] == pytest.approx(0.001, rel=0.05)
    assert model.kp_Nm_per_rad == pytest.approx(2.2, rel=0.03)


def test_a_wish_that_cannot_be_met_is_told():
    model = identify([record(SERVO)], bench("j1"), effects=["unmodelled_inertia"]).joints["j1"]
    assert any("needs a pendulum or two known loads" in note for note in model.notes)


def test_water_is_remarked_on():
    wet = Recording(**{**vars(record(SERVO)), "medium": "water"})
    assert "added mass" in identify([wet], bench("j1")).notes[0]


def test_missing_physics_is_not_hidden():
    recording = record(SERVO, t=HALF)
    t, command = recording.t, recording.command[:, 0]
    laggy = plant.simulate(SERVO, t, t, command)[:, 0]
    for k in range(1, t.size):  # a sensor that follows by 60 ms
        laggy[k] = laggy[k - 1] + 0.28 * (laggy[k] - laggy[k - 1])
    laggy += np.random.default_rng(0).normal(0, 0.001, t.size)
    other = Recording(**{**vars(recording), "position": laggy[:, None]})
    model = identify([other], bench("j1")).joints["j1"]
    assert any("physics is missing" in note for note in model.notes)


def test_predict_gives_the_model_back(fitted):
    t = np.arange(0, 3, 0.02)
    command = np.where(t > 0.5, 0.3, 0.0)
    expected = plant.simulate(SERVO, t, t, command)[:, 0]
    angle = predict(fitted, t, {"j1": command}, {"j1": Load(0.002)})["j1"]
    assert np.abs(angle - expected).max() < 0.004
    with pytest.raises(InputError, match="joint j9"):
        predict(fitted, t, {"j9": command})


def test_no_motion_is_refused():
    t = np.arange(0, 5, 0.02)
    still = Recording(
        "still", "servo", ("j1",), t, np.zeros((t.size, 1)), np.zeros((t.size, 1)), {}
    )
    with pytest.raises(InputError, match=r"still.csv: j1.position_rad: found no motion"):
        identify([still], bench("j1"))


def test_motion_lost_in_the_noise_is_refused():
    t = np.arange(0, 10, 0.02)
    with pytest.raises(InputError, match="no motion above the noise of 1.5 mrad"):
        identify([record(SERVO, np.where(t > 5, 2e-5, 0.0), t=t)], bench("j1"))


def test_a_value_at_its_bound_is_flagged():
    early = plant.Servo(2.2, 0.06, -0.003, 0.002)  # acts before it is told: clocks that disagree
    model = identify([record(early, t=HALF)], bench("j1")).joints["j1"]
    assert model.latency_s == 0.0
    assert any("latency is at its bound of 0" in note for note in model.notes)


def test_a_parameter_without_influence_is_found_before_the_fit():
    t = np.arange(0, 10, 0.02)
    lone = np.where(t > t[-2], 0.3, 0.0)  # set-point that takes effect after the recording ends
    early = np.where(t > 2, 0.002, 0.0)
    model = identify([record(SERVO, early, t=t, noise=0.0004), record(SERVO, lone, t=t, name="b",
                      noise=0.0004)], bench("j1")).joints["j1"]  # fmt: skip
    words = ("influence", "determined", "constrain")
    assert any(word in note for note in model.notes for word in words), model.notes


def test_a_joint_that_does_not_move_is_named():
    one = record(SERVO)
    two = np.hstack([one.command, 0 * one.command]), np.hstack([one.position, 0 * one.position])
    recording = Recording("steps", "servo", ("j1", "j2"), one.t, *two, one.loads)
    model = identify([recording], bench("j1", "j2"))
    assert list(model.joints) == ["j1"]
    assert model.notes == ("j2 does not move in these recordings and is not identified",)


def test_wrong_wishes_are_refused():
    recording = record(SERVO)
    with pytest.raises(InputError, match="'j1'.*one of j7"):
        identify([recording], bench("j7"))
    with pytest.raises(InputError, match="'walk'.*one of steps"):
        identify([recording], bench("j1"), held_out="walk")
    with pytest.raises(InputError, match="the recording twice"):
        identify([recording, recording], bench("j1"))
    other = record(SERVO, loads=False, name="more")
    with pytest.raises(InputError, match="in all or in none"):
        identify([recording, other], bench("j1"))
    silent = Recording(**{**vars(recording), "command": np.full_like(recording.command, np.nan)})
    with pytest.raises(InputError, match="no J.command_rad column"):
        identify([silent], bench("j1"))
