"""What every servo has a little of belongs to the plain servo, and is no finding."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from searching import searched
from simulated import INERTIA, KD, KP, LATENCY, NOISE, SHEET, robot, row, traced, two

from sim2real.diagnose.case import JointCase
from sim2real.diagnose.diagnose import _first_look, diagnose
from sim2real.diagnose.effect_search import _best, first_look, size_in_noise, with_nuisances
from sim2real.diagnose.screening import as_read
from sim2real.diagnose.servo_search import ServoSearch, baselines, plain_sets
from sim2real.effects import named
from sim2real.identification.priors import largest_rotor
from sim2real.identification.servo_problem import Hypothesis
from sim2real.model import FittedEffect, JointModel, Model
from sim2real.recording import Load
from sim2real.robot import Servo
from sim2real.servo.batch import Batch
from sim2real.servo.parameters import COLUMNS, joint_row
from sim2real.servo.rollout import rollout

WAVE = {"amplitude_rad": 4 * NOISE, "period_rad": 0.6, "phase_rad": 0.5}


@pytest.fixture(scope="module")
def wavy():
    return searched(sensor_eccentricity=WAVE).tried


def test_a_sensor_that_errs_by_a_little_wave_is_a_plain_servo(wavy):
    assert "sensor_eccentricity" in wavy.base
    assert size_in_noise(wavy.plain, "sensor_eccentricity", NOISE) == pytest.approx(4, rel=0.3)


def test_the_base_has_no_prior_that_other_sets_lack():
    """What every set has costs none of them: the plain servo is not compared with a handicap."""
    traces = [traced(1, "a", sensor_eccentricity=WAVE)]
    batch, joints = Batch([traces]), [JointCase("j1", traces, NOISE, None)]
    problem = ServoSearch(batch, joints, 0.01, np.random.default_rng(0))
    cases = plain_sets(baselines(batch))
    first_look(problem, cases)
    (based,) = with_nuisances(problem, cases, [cases[0].best])
    assert "sensor_eccentricity" in based.base
    (again,) = problem.refit([(based, based.base, based.plain.fit.servos.theta[0])])
    assert again.evidence == pytest.approx(based.plain.evidence, abs=0.5)


def test_a_servo_without_a_wave_gets_none(nothing):
    assert nothing.tried.base == frozenset()


def explained(evidence, **waves_rad):
    """A set of nuisances of these sizes on a servo of 2 N m/rad."""
    theta = np.zeros((1, len(COLUMNS)))
    theta[0, 0] = 2.0
    for name, size in waves_rad.items():
        first = named(name).parameters[0].name
        theta[0, COLUMNS.index(f"{name}.{first}")] = size * (2.0 if first == "torque_Nm" else 1.0)
    fit = SimpleNamespace(servos=SimpleNamespace(theta=theta))
    return Hypothesis(frozenset(waves_rad), fit, evidence)


def test_no_small_wave_stands_in_for_a_large_one():
    bare, large = explained(0.0), explained(500.0, cogging=0.03)
    small = explained(60.0, cogging=0.005)
    assert _best(bare, [small], large_rad=0.01) is small
    assert _best(bare, [small, large], large_rad=0.01) is bare


GAIN, OFFSET = 0.04, 0.012


def test_waves_stay_where_they_were_seen_when_a_gain_and_an_offset_of_the_sensor_leave():
    wave = {"torque_Nm": 0.02, "period_rad": 0.1, "phase_rad": 0.7}
    errors = {"sensor_gain": {"gain": GAIN}, "sensor_offset": {"offset_rad": OFFSET}}
    before = row(cogging=wave, **errors)
    after = as_read(before, frozenset({"cogging"}))
    q = np.linspace(-0.8, 0.8, 200)

    def torque(theta, angle):
        period, phase = (theta[COLUMNS.index(f"cogging.{n}_rad")] for n in ("period", "phase"))
        return np.sin(2 * np.pi * angle / period + phase)

    seen = (1 + GAIN) * q + OFFSET
    np.testing.assert_allclose(torque(after, seen), torque(before, q), atol=1e-9)
    np.testing.assert_array_equal(as_read(before, frozenset({"cogging", *errors})), before)


@pytest.mark.parametrize(
    ("effect", "parameter", "value"),
    [("sensor_offset", "offset_rad", -0.0408), ("sensor_gain", "gain", 0.04)],
)
def test_an_error_of_the_sensor_is_found_beside_cogging(effect, parameter, value):
    cogging = {"torque_Nm": 0.016, "period_rad": 0.0816, "phase_rad": -2.4}
    given = {effect: {parameter: value}, "cogging": cogging, "noise": NOISE / 3}
    result = searched(2 * NOISE, [traced(k, "ab"[k], **given) for k in range(2)])
    found, problem = result.tried, result.search
    assert effect in found.best.members
    column = COLUMNS.index(f"{effect}.{parameter}")
    assert found.best.fit.servos.theta[0, column] == pytest.approx(value, rel=0.05)
    # The plain servo's angle has no error of the sensor, so its waves stay as one is added.
    start = dict(problem.additions(found, found.base, 3))[effect]
    waves = [COLUMNS.index(f"cogging.{name}") for name in cogging]
    np.testing.assert_array_equal(start[waves], found.plain.fit.servos.theta[0, waves])


def lined(stall_Nm, no_load=20.0, **effects):
    """The joint, after a first look, of a servo on a line of torque over speed."""
    motor = {"stall_torque_Nm": stall_Nm, "no_load_speed_rad_s": no_load}
    fitted = tuple(FittedEffect(name, values) for name, values in effects.items())
    model = JointModel(KP, KD, LATENCY, INERTIA, law="motor", motor=motor, effects=fitted)
    rng, traces = np.random.default_rng(0), []
    for k in range(2):
        bare = traced(k, "ab"[k])
        angle = rollout(joint_row(model, None)[None], bare.t, bare.command)[0]
        traces.append(replace(bare, position=angle + rng.normal(0, NOISE, angle.size)))
    servo = Servo("s", 1.05 * stall_Nm, 1.05 * no_load, 0.0)
    (joint,), _ = _first_look([JointCase("j1", traces, NOISE, None, servo=servo)], rng)
    return joint


RUBBING = {"coulomb_friction": {"torque_Nm": 0.08}}


def test_friction_does_not_hide_that_the_motor_reaches_its_line():
    motor = lined(0.8, **RUBBING).model.motor
    assert motor["stall_torque_Nm"] == pytest.approx(0.8, rel=0.15)


def test_a_lower_limit_of_current_is_tried_on_the_line():
    joint = lined(0.4, 7.0, torque_saturation={"limit_Nm": 0.15, "free_damping": 0.0})
    assert joint.model.motor["no_load_speed_rad_s"] == pytest.approx(7.0, rel=0.1)
    effects, with_rotor = joint.stated[-1]
    assert effects >= {"torque_saturation", "unmodelled_inertia"}
    assert with_rotor[COLUMNS.index("unmodelled_inertia.inertia_kgm2")] > 0


def test_a_motor_that_stays_below_its_line_shows_none():
    assert lined(3.0, **RUBBING).model is None


LOAD, ROTOR = Load(INERTIA, 0.1, 0.1), 0.6 * INERTIA
"""A pendulum, which shows the inertia, and the rotor of the servo that turns it."""


def diagnosed(loaded=LOAD, stated=LOAD, bench=None, model=None, **effects):
    """The diagnosis of a servo with a load, of which another is stated."""
    effects = {"unmodelled_inertia": {"inertia_kgm2": ROTOR}} | effects
    some = two(load=loaded, **effects)
    some = [replace(one, loads={"j1": stated}) for one in some]
    return diagnose(some, bench or robot("j1"), model=model)


def known():
    """The servo as it was identified on another day, with the inertia of its rotor."""
    motor = {"rotor_inertia_kgm2": ROTOR}
    joint = JointModel(KP, KD, LATENCY, INERTIA, law="motor", motor=motor, load=LOAD)
    return Model({"j1": joint})


def test_a_rotor_is_part_of_the_plain_servo():
    found = diagnosed()
    assert found.verdict == "consistent"
    assert not (found.effects or found.negligible or found.mismatch)
    for model in (found.model, found.baseline):
        joint = model.joints["j1"]
        assert joint.motor["rotor_inertia_kgm2"] == pytest.approx(ROTOR, rel=0.03)
        assert joint.kp_Nm_per_rad == pytest.approx(KP, rel=0.02)
    assert found.baseline_fit["j1.position_rad"]["heldout"] == pytest.approx(NOISE, rel=0.1)
    (note,) = found.notes
    assert "in addition to the stated load" in note
    assert note in str(found)
    assert diagnosed(model=known()).verdict == "consistent"


def test_a_payload_that_is_not_stated_is_found_where_the_rotor_is_known():
    heavier = replace(LOAD, inertia_kgm2=1.5 * INERTIA)
    found = diagnosed(loaded=heavier, model=known())
    (effect,) = found.effects
    assert effect.effect == "unmodelled_inertia"
    assert effect.parameters["inertia_kgm2"].mean == pytest.approx(0.5 * INERTIA, rel=0.05)
    assert not diagnosed(loaded=heavier).effects, "a rotor of that size is likely"


def test_an_inertia_that_no_rotor_has_is_found():
    """Beyond what the data sheet makes likely, or less than nothing."""
    servo = replace(SHEET, max_torque_Nm=3.0, no_load_speed_rad_s=400.0)
    small = robot("j1", servo=servo)
    assert largest_rotor(servo) < ROTOR
    assert [one.effect for one in diagnosed(bench=small).effects] == ["unmodelled_inertia"]
    lighter = {"unmodelled_inertia": {"inertia_kgm2": -0.2 * INERTIA}}
    assert [one.effect for one in diagnosed(**lighter).effects] == ["unmodelled_inertia"]


def test_play_is_named_alone_where_its_rotor_is_not_in_the_stated_load():
    play = {"gap_rad": 0.03, "rotor_inertia_kgm2": ROTOR, "output_friction_Nm": 0.01}
    found = diagnosed(backlash=play, unmodelled_inertia={"inertia_kgm2": 0.0})
    assert [one.effect for one in found.effects] == ["backlash"]
    for name in ("gap_rad", "rotor_inertia_kgm2"):
        assert found.effects[0].parameters[name].mean == pytest.approx(play[name], rel=0.05)
