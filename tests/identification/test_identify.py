"""The fit: known servos come back, what is not known is said, and nothing is scored on itself."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lfilter
from simulated import beside, one_joint, robot

from datasets.servo_steps import make as plant
from sim2real.errors import InputError
from sim2real.identification.identify import identify
from sim2real.model import read_model, write_model
from sim2real.recording import Load, read_recording
from sim2real.robot import read_robot
from sim2real.servo.prediction import replay

DATA = Path(__file__).parents[2] / "datasets" / "servo_steps"
NAMES = ("kp_Nm_per_rad", "kd_Nms_per_rad", "latency_s")
GAINS = list(NAMES[:2])


def record(servo, command=None, *, seed=0, loads=True, name="steps", t=None, noise=0.0015):
    """One joint, made by the data set's own plant."""
    rng = np.random.default_rng(seed)
    t = np.arange(0, 20, 0.02) if t is None else t
    command = plant.steps(t - 0.5, rng) * (t > 0.5) if command is None else command
    angle = plant.simulate(servo, t, t, command)[:, 0] + rng.normal(0, noise, t.size)
    return one_joint(t, command, angle, Load(servo.inertia_kgm2) if loads else None, name)


def identified(*recordings, **options):
    """Joint j1 of the model of these recordings."""
    return identify(list(recordings), robot("j1"), **options).joints["j1"]


SERVO = plant.Servo(2.2, 0.06, 0.0683, 0.002)
HALF = np.arange(0, 8, 0.02)
"""Times of a recording for fits that no servo suits, which take long."""


@pytest.fixture(scope="module")
def shipped():
    names = ("steps", "square", "sine", "chirp")
    recordings = [read_recording(DATA / f"{name}.csv") for name in names]
    return recordings, identify(recordings, read_robot(DATA / "robot.toml"))


@pytest.fixture(scope="module")
def fitted():
    return identify([record(SERVO)], robot("j1"))


def test_shipped_servos_are_recovered_and_the_residual_is_noise_on_what_was_held_out(shipped):
    recordings, model = shipped
    truth = json.loads((DATA / "truth.json").read_text())["joints"]
    for joint, servo in model.joints.items():
        for name in NAMES:
            assert getattr(servo, name) == pytest.approx(truth[joint][name], rel=0.01)
            low, high = servo.interval[name]
            assert low < getattr(servo, name) < high
        assert servo.notes == ()
    assert set(model.provenance["held_out"].values()) == {"chirp"}
    for figures in model.fit.values():
        assert figures["heldout"] == pytest.approx(figures["noise"], rel=0.2)
        assert abs(figures["whiteness"]) < 0.1
    for one in replay(model, recordings):
        assert one.held_out.any() == (one.recording.name == "chirp")
        error = one.predicted - one.recording.position[:, one.recording.joints.index(one.joint)]
        assert np.nanstd(error) < 0.0025


def test_same_seed_same_model(fitted):
    assert identified(record(SERVO)) == fitted.joints["j1"]


def test_residuals_and_covariance_are_those_of_the_fit(shipped, tmp_path):
    _, model = shipped
    write_model(model, tmp_path / "model.json")
    again = read_model(tmp_path / "model.json")
    assert again == model and again.residuals is None
    table = model.to_dataframe()
    for name, joint in model.joints.items():
        of_joint = model.residuals[model.residuals["joint"] == name]
        assert set(of_joint["recording"]) == {"steps", "square", "sine", "chirp"}
        rms = np.sqrt((of_joint["residual_rad"] ** 2).mean())
        assert rms == pytest.approx(model.fit[f"{name}.position_rad"]["train"])
        (kp, both), (_, kd) = again.covariance[name].loc[GAINS, GAINS].to_numpy()
        assert both / np.sqrt(kp * kd) == pytest.approx(joint.correlation[", ".join(GAINS)])
        row = table.loc[name, GAINS[0]]
        assert row["value"] == joint.kp_Nm_per_rad
        assert (row["high"] - row["low"]) / row["standard_error"] == pytest.approx(3.3, rel=0.05)
        assert row["standard_error"] == pytest.approx(np.sqrt(kp))


def test_held_out_samples_touch_the_model_but_not_the_fit_that_is_scored(fitted):
    recording = record(SERVO)
    spoiled = recording.position.copy()
    spoiled[800:] += 0.1  # after the last three quarters
    fits = [
        identify([one], robot("j1"), refit=False)
        for one in (recording, replace(recording, position=spoiled))
    ]
    assert fits[0].joints["j1"].interval == fits[1].joints["j1"].interval
    errors = [model.fit["j1.position_rad"]["heldout"] for model in (fitted, *fits)]
    assert errors[0] == errors[1] and errors[2] > 0.05
    for name in NAMES:  # with all samples it is better determined
        both = (np.ptp(model.joints["j1"].interval[name]) for model in (fitted, fits[0]))
        assert next(both) < next(both)


def test_outliers_do_not_move_the_fit(fitted):
    clean = record(SERVO)
    spoiled, rng = clean.position.copy(), np.random.default_rng(1)
    spoiled[rng.choice(spoiled.size, 20, replace=False)] += rng.choice([-2.0, 1.5], (20, 1))
    found = identified(replace(clean, position=spoiled))
    for name in NAMES:
        assert getattr(found, name) == pytest.approx(getattr(fitted.joints["j1"], name), rel=0.01)


def test_missing_samples_and_a_gap():
    recording = record(SERVO)
    position = recording.position[:, 0].copy()
    position[::7] = np.nan
    keep = np.ones(recording.t.size, dtype=bool)
    keep[400:404] = False
    t, command = recording.t[keep], recording.command[keep, 0]
    joint = identified(one_joint(t, command, position[keep]))
    # set-points sent in the gap are lost with it, so the tolerance is wider than without
    assert joint.kp_Nm_per_rad == pytest.approx(2.2, rel=0.03)


def test_slow_motion_leaves_directions_open_and_says_so():
    t = np.arange(0, 20, 0.02)
    joint = identified(record(SERVO, 0.3 * np.sin(0.05 * 2 * np.pi * t)))
    reasons = ("do not constrain", "no influence", "cannot be determined", "another optimum")
    assert any(reason in note for note in joint.notes for reason in reasons)
    low, high = joint.interval["kp_Nm_per_rad"]
    assert low < 2.2 < high
    assert high > 20 * low
    assert np.isinf(joint.standard_error["kp_Nm_per_rad"]) == np.isinf(high)


def pendulum(extra):
    """A servo whose load leaves out ``extra``, simulated by scipy."""
    kp, kd, inertia, gravity = 0.5, 0.03, 0.0049 + extra, 0.49 * 9.80665 * 0.1
    t = np.arange(0, 12, 0.005)

    def sent(x):
        return np.where(x > 0, np.sin(x**2 / 2), 0.0)

    def slope(x, y):
        pull = kp * (sent(x - 0.002) - y[0]) - kd * y[1]
        return [y[1], (pull - gravity * np.sin(y[0])) / inertia]

    angle = solve_ivp(slope, (0, 12), [0, 0], t_eval=t, max_step=0.005, rtol=1e-9, atol=1e-11).y[0]
    noisy = angle + np.random.default_rng(0).normal(0, 0.001, t.size)
    return one_joint(t, sent(t), noisy, Load(0.0049, 0.49, 0.1))


def test_incomplete_load_is_noticed_and_can_be_fitted():
    recording = pendulum(extra=0.0017)
    held = identified(recording, law="pd")
    assert any("contradict the stated inertia" in note for note in held.notes)
    freed = identified(recording, effects=["unmodelled_inertia"])
    (effect,) = freed.effects
    assert effect.parameters["inertia_kgm2"] == pytest.approx(0.0017, rel=0.05)
    assert freed.latency_s < 0.006
    assert held.latency_s - freed.latency_s > 0.005, "held inertia invents latency"
    complete = identified(pendulum(extra=0.0))
    assert not any("contradict" in note for note in complete.notes), "it is not accused"


def under_two_loads(rotor):
    """Recordings of a servo whose stated loads leave out its rotor."""
    for seed, inertia in enumerate((0.002, 0.006)):
        turned = record(replace(SERVO, inertia_kgm2=inertia + rotor), seed=seed, name=f"{inertia}")
        yield replace(turned, loads={"j1": Load(inertia)})


def test_two_known_loads_show_a_rotor_without_a_pendulum():
    light, heavy = under_two_loads(0.001)
    again = replace(light, name="again")
    joint = identified(light, heavy, again, effects=["unmodelled_inertia"])
    assert joint.effects[0].parameters["inertia_kgm2"] == pytest.approx(0.001, rel=0.05)
    assert joint.kp_Nm_per_rad == pytest.approx(2.2, rel=0.03)


def test_the_parts_of_the_law_are_chosen_with_the_recording_that_was_held_out():
    """Only both loads show the rotor; the fit that is scored has one of them."""
    joint = identified(*under_two_loads(0.001))
    assert joint.motor["rotor_inertia_kgm2"] == pytest.approx(0.001, rel=0.05)
    assert joint.kp_Nm_per_rad == pytest.approx(2.2, rel=0.02)


def test_water_is_remarked_on_and_a_wish_that_cannot_be_met():
    wet = replace(record(SERVO), medium="water")
    model = identify([wet], robot("j1"), effects=["unmodelled_inertia"])
    assert "added mass" in model.notes[0]
    notes = model.joints["j1"].notes
    assert any("needs a pendulum or two known loads" in note for note in notes)


def test_missing_physics_is_not_hidden():
    recording = record(SERVO, t=HALF)
    command = recording.command[:, 0]
    laggy = plant.simulate(SERVO, HALF, HALF, command)[:, 0]
    laggy = lfilter([0.28], [1, -0.72], laggy)  # of a sensor that follows by 60 ms
    laggy += np.random.default_rng(0).normal(0, 0.001, HALF.size)
    joint = identified(replace(recording, position=laggy[:, None]))
    assert any("physics is missing" in note for note in joint.notes)


def test_no_motion_above_the_noise_is_refused():
    still = one_joint(HALF, 0 * HALF, 0 * HALF, None, "still")
    with pytest.raises(InputError, match=r"still.csv: j1.position_rad: found no motion"):
        identified(still)
    with pytest.raises(InputError, match="no motion above the noise of 1.5 mrad"):
        identified(record(SERVO, np.where(HALF > 5, 2e-5, 0.0), t=HALF))


def test_a_value_at_its_bound_is_flagged():
    early = replace(SERVO, latency_s=-0.003)  # acts before it is told: clocks that disagree
    joint = identified(record(early, t=HALF))
    assert joint.latency_s == 0.0
    assert any("latency is at its bound of 0" in note for note in joint.notes)


def test_a_parameter_without_influence_is_found_before_the_fit():
    lone = np.where(HALF[-2] < HALF, 0.3, 0.0)  # which takes effect after the recording ends
    early = np.where(HALF > 2, 0.002, 0.0)
    given = (
        record(SERVO, command, t=HALF, name=name, noise=0.0004)
        for name, command in (("a", early), ("b", lone))
    )
    words, notes = ("influence", "determined", "constrain"), identified(*given).notes
    assert any(word in note for note in notes for word in words), notes


def test_a_joint_that_does_not_move_is_named():
    one = record(SERVO)
    still = replace(one, command=0 * one.command, position=0 * one.position)
    model = identify([beside(one, still)], robot("j1", "j2"))
    assert list(model.joints) == ["j1"]
    assert model.notes == ("j2 does not move in these recordings and is not identified",)


def test_wrong_wishes_are_refused():
    recording = record(SERVO, t=HALF)
    other = record(SERVO, t=HALF, loads=False, name="more")
    silent = replace(recording, command=np.full_like(recording.command, np.nan))
    for given, joint, options, message in (
        ([recording], "j7", {}, "'j1'.*one of j7"),
        ([recording], "j1", {"held_out": "walk"}, "'walk'.*one of steps"),
        ([recording, recording], "j1", {}, "the recording twice"),
        ([recording, other], "j1", {}, "in all or in none"),
        ([silent], "j1", {}, "no J.command_rad column"),
    ):
        with pytest.raises(InputError, match=message):
            identify(given, robot(joint), **options)


def test_the_probability_of_intervals_is_stated_and_widens_them(fitted, tmp_path):
    wide = identify([record(SERVO)], robot("j1"), interval=0.99)
    write_model(wide, tmp_path / "m.json")
    assert read_model(tmp_path / "m.json").interval_level == 0.99
    for name in NAMES:
        ends = fitted.joints["j1"].interval[name], wide.joints["j1"].interval[name]
        assert np.ptp(ends[1]) > 1.3 * np.ptp(ends[0])
    with pytest.raises(InputError, match="interval: found 1.5"):
        identify([record(SERVO)], robot("j1"), interval=1.5)
