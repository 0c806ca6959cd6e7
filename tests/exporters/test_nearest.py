"""What a target lacks is dropped, and what is left is fitted again to move as the whole did."""

import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
import simulated
from exported import TYPICAL, export, joint, needs_mujoco, servo, typical

from sim2real.exporters.mujoco_bench import CASES, mujoco_error, mujoco_export
from sim2real.exporters.nearest import excitation, nearest, without
from sim2real.exporters.simulators import TARGETS
from sim2real.identification.search import errors_of
from sim2real.inference.least_squares import rms
from sim2real.model import Model
from sim2real.recording import Load
from sim2real.servo.parameters import joint_row

LOAD = Load(simulated.INERTIA)
DEADBAND = {"halfwidth_rad": 0.02}
LINE = {"stall_torque_Nm": 1.5, "no_load_speed_rad_s": 8.0}


def apart(one, other):
    """RMS difference of two models on the standard excitation, rad."""
    own = excitation(one.joints["j1"], "j1")
    return rms(errors_of(joint_row(other.joints["j1"], LOAD), own))


@pytest.mark.parametrize("target", ["mujoco", "isaaclab", "genesis", "urdf"])
@pytest.mark.parametrize("effect", ["deadband", "load_friction", "sensor_filter"])
def test_a_refit_is_nearer_than_dropping(target, effect):
    model = servo(**typical(effect))
    found = nearest(model, TARGETS[target].expressed)
    (refit,) = found.refits
    assert effect not in {e.effect for e in found.model.joints["j1"].effects}
    assert refit.full_rad == pytest.approx(apart(model, found.model), rel=1e-6)
    assert refit.dropped_rad == pytest.approx(apart(model, servo()), rel=1e-6)
    assert refit.full_rad < 0.6 * refit.dropped_rad
    assert any(effect in line.what for line in found.dropped)
    text = TARGETS[target].write(found.model, None, found.dropped).text.replace("- -", "--")
    assert all(str(line) in text for line in found.dropped)


@pytest.mark.parametrize("effect", ["backlash", "compliance"])
def test_the_rotor_of_a_gear_train_that_a_target_lacks_still_turns_with_the_load(effect):
    rotor, beside = 0.0015, 0.0004
    train = {effect: TYPICAL[effect] | {"rotor_inertia_kgm2": rotor}}
    whole = joint(unmodelled_inertia={"inertia_kgm2": beside}, **train)
    for one in (whole, without(whole, {effect})):
        text = TARGETS["urdf"].write(Model({"j1": one})).text
        inertia = ElementTree.fromstring(text).findall(".//inertial/inertia")[-1]
        total = LOAD.inertia_kgm2 + rotor + beside
        assert float(inertia.attrib["iyy"]) == pytest.approx(total)


def test_what_a_target_expresses_stays_to_the_last_digit():
    model = servo(**typical("coulomb_friction"))
    for target in TARGETS.values():
        found = nearest(model, target.expressed)
        assert found.model.joints == model.joints
        assert not found.refits and not found.dropped


@needs_mujoco
def test_a_dead_band_is_soft_dry_friction_in_mujoco():
    _, found, (agreement,) = mujoco_export(servo(deadband=DEADBAND))
    motor = found.model.joints["j1"].motor
    assert motor["stick_time_s"] == pytest.approx(simulated.INERTIA / simulated.KD, rel=0.05)
    assert found.refits[0].full_rad < 1e-4
    assert agreement.error_rad < 1e-3


def test_expressed_effects_are_fitted_again_beside_those_dropped():
    model = servo(coulomb_friction={"torque_Nm": 0.05}, deadband=DEADBAND)
    found = nearest(model, TARGETS["mujoco"].expressed)
    (left,) = found.model.joints["j1"].effects
    assert left.effect == "coulomb_friction"
    assert left.parameters["torque_Nm"] > 0.055  # a dead band is like more dry friction


def test_losses_of_a_motor_become_dry_friction_and_zeros_are_not_listed():
    line = LINE | {"coulomb_Nm": 0.02}
    model = servo(motor=line | {"load_friction": 1e-13, "motor_friction": 0.2})
    found = nearest(model, TARGETS["mujoco"].expressed)
    (refit,) = found.refits
    assert refit.dropped == ("motor.motor_friction",)
    assert refit.full_rad < 0.6 * refit.dropped_rad
    assert set(found.model.joints["j1"].motor) == set(line)
    assert "load_friction" not in TARGETS["mujoco"].write(found.model, None, found.dropped).text


@pytest.mark.parametrize("target", ["isaaclab", "genesis", "urdf"])
@pytest.mark.parametrize("effect", ["gravity_load", "sensor_offset", "encoder_quantization"])
def test_what_nothing_can_stand_in_for_is_listed_and_not_refitted(target, effect):
    model = servo(**typical(effect))
    found = nearest(model, TARGETS[target].expressed)
    assert found.model.joints == model.joints
    listed = TARGETS[target].write(found.model, None, found.dropped).left_out
    assert any(effect in line.what for line in listed)


def test_nothing_that_hardly_moves_the_joint_is_listed():
    model = servo(deadband={"halfwidth_rad": 1e-6}, presliding_friction={"torque_Nm": 0.0})
    found = nearest(model, TARGETS["urdf"].expressed)
    assert not found.refits and not found.dropped
    assert not found.model.joints["j1"].effects


@needs_mujoco
def test_a_refit_to_recordings_scores_on_the_last(tmp_path, capsys):
    recordings = [simulated.recording(k, name, deadband=DEADBAND) for k, name in enumerate("ab")]
    assert export(tmp_path, servo(deadband=DEADBAND), recordings, "mujoco") == 0
    line, mujoco_itself = capsys.readouterr().out.splitlines()[-2:]
    exported, full = map(float, re.search(r"on b, held out: (\S+) .* (\S+) of", line).groups())
    assert full == pytest.approx(1e3 * simulated.NOISE, rel=0.15)
    assert full < exported < 5 * full
    said = re.search(r"j1: this actuator in MuJoCo: (\S+) .* b, held out", mujoco_itself)
    assert float(said.group(1)) == pytest.approx(exported, rel=0.1)
    assert "deadband (halfwidth_rad = 0.02)" in (tmp_path / "servo.txt").read_text()


def test_recordings_without_a_joint_of_the_model_are_refused(tmp_path, capsys):
    assert export(tmp_path, Model({"j9": joint()}), [simulated.recording(0, "a")], "mujoco") == 2
    assert "found joints j1, expected one of j9" in capsys.readouterr().err
    assert not (tmp_path / "servo.txt").exists()


def test_gains_per_inertia_stay_per_inertia():
    whole = replace(
        joint(Load(1.0), latency_s=0.05, kd=30.0, deadband=DEADBAND),
        kp_Nm_per_rad=1100.0, per_inertia=True, load=None,
    )  # fmt: skip
    recordings = [simulated.recording(seed, f"{seed}", deadband=DEADBAND) for seed in (0, 1)]
    found = nearest(Model({"j1": whole}), TARGETS["mujoco"].expressed, recordings)
    new = found.model.joints["j1"]
    assert new.per_inertia
    assert new.inertia_kgm2 == 1
    assert new.kp_Nm_per_rad == pytest.approx(1100, rel=0.3)  # softened, as a dead band does


@pytest.mark.parametrize("no_load_speed", [4.0, 40.0])
def test_damping_of_joint_and_controller_in_a_urdf_are_positive_and_the_whole(no_load_speed):
    line = {"stall_torque_Nm": 1.0, "no_load_speed_rad_s": no_load_speed}
    made = TARGETS["urdf"].write(servo(motor=line))
    dynamics = ElementTree.fromstring(made.text).find("joint/dynamics")
    own = float(dynamics.get("damping", "nan"))
    controller = sum(
        float(re.search(r"kd \((\S+)", line.what).group(1))
        for line in made.left_out
        if line.what.startswith("kd ")
    )
    assert own == pytest.approx(min(simulated.KD, 1.0 / no_load_speed))
    assert controller >= 0
    assert own + controller == pytest.approx(simulated.KD)


def test_the_standard_excitation_starts_at_rest_and_is_within_reach():
    for trace in excitation(joint(), "j1", 0.4):
        assert trace.command[0] == 0
        assert 0.2 < np.abs(trace.command).max() <= 0.4


@needs_mujoco
def test_bristles_give_way_to_dry_friction_where_mujoco_steps_them_badly():
    stiff = {"torque_Nm": 0.02, "stiffness_Nm_per_rad": 30.0, "damping_ratio": 2.0}
    model = servo(presliding_friction=stiff)
    made, _, (after,) = mujoco_export(model)
    as_it_is = mujoco_error(model.joints["j1"], "j1", excitation(model.joints["j1"], "j1"))
    assert after.error_rad < 0.7 * as_it_is
    assert "frictionloss" in made.text
    assert any("presliding_friction" in line.what for line in made.left_out)
    model = servo(presliding_friction=TYPICAL["presliding_friction"] | {"damping_ratio": 0.2})
    _, found, (agreement,) = mujoco_export(model)
    assert found.model.joints == model.joints, "these it steps well"
    assert agreement.error_rad < 1e-3


@needs_mujoco
def test_each_recording_is_run_on_its_own_load():
    heavy = Load(0.005, 0.1, 0.15)
    recordings = [simulated.recording(0, "light"), simulated.recording(1, "heavy", load=heavy)]
    _, _, (agreement,) = mujoco_export(servo(), recordings)
    assert agreement.what == "heavy, held out"
    assert agreement.error_rad == pytest.approx(simulated.NOISE, rel=0.2)


@pytest.mark.parametrize("target", [pytest.param("mujoco", marks=needs_mujoco), "genesis"])
@pytest.mark.parametrize(("torque_Nm", "plain"), [(0.0, True), (0.12, False)])
def test_the_plain_servo_is_exported_where_it_is_nearer(target, torque_Nm, plain, tmp_path, capsys):
    """A model with friction that the recordings do not have, and one with what they have."""
    friction = {"coulomb_friction": {"torque_Nm": torque_Nm}} if torque_Nm else {}
    recordings = [simulated.recording(k, name, 6.0, **friction) for k, name in enumerate("ab")]
    model = servo(coulomb_friction={"torque_Nm": 0.12})
    expected, errors = "plain servo" if plain else "servo with effects", {}
    for which in ("nearest", "plain"):
        assert export(tmp_path, model, recordings, target, "--which", which) == 0
        said = capsys.readouterr().out
        found = re.search(r"(\S+) mrad RMS from the recordings .* (\S+) mrad .* plain servo", said)
        errors[which] = [float(x) for x in found.groups()]
        assert which == "plain" or f"the {expected} is exported" in said
    assert errors["nearest"] == errors["plain"]
    assert (errors["nearest"][0] > errors["nearest"][1]) == plain
    if plain:
        assert export(tmp_path, model, recordings, target, "--which", "effects") == 0
        assert "0.12" in (tmp_path / "servo.txt").read_text()


def test_a_target_with_one_limit_has_the_one_that_matters():
    """A limit of the current far below the stall torque replaces the torque-speed line."""
    limit = {"torque_saturation": {"limit_Nm": 0.2, "free_damping": 0.0}}
    recordings = [simulated.recording(k, f"{k}", 6.0, **limit) for k in (0, 1)]
    found = nearest(servo(motor=LINE, **limit), TARGETS["mjlab"].expressed, recordings)
    (refit,) = found.refits
    assert refit.recorded_rad[1] < 1.2 * simulated.NOISE
    assert "effort_limit=0.2," in TARGETS["mjlab"].write(found.model).text


def test_damping_beyond_a_limit_is_refitted_where_it_is_lacking():
    whole = joint(motor=LINE, torque_saturation={"limit_Nm": 0.2, "free_damping": 0.4})
    has = TARGETS["isaaclab"].expressed(whole)
    assert "torque_saturation" in has and "torque_saturation.free_damping" not in has
    (found,) = nearest(Model({"j1": whole}), TARGETS["isaaclab"].expressed).model.joints.values()
    (effect,) = found.effects
    assert effect.parameters["free_damping"] == 0.0 < effect.parameters["limit_Nm"]


def test_a_refit_to_recordings_keeps_the_limits_of_the_motor():
    """They are what other recordings told, and these may reach them hardly or not at all."""
    recordings = [simulated.recording(k, f"{k}", 6.0, deadband=DEADBAND) for k in (0, 1)]
    model = servo(motor=LINE, deadband=DEADBAND)
    (found,) = nearest(model, TARGETS["genesis"].expressed, recordings).model.joints.values()
    assert {name: found.motor[name] for name in LINE} == LINE


def test_a_limit_that_nothing_reaches_is_said():
    model = servo(motor=LINE, torque_saturation={"limit_Nm": 1.49, "free_damping": 0.0})
    (line,) = nearest(model, TARGETS["mjlab"].expressed).dropped
    assert "no motion" in line.why
    (line,) = mujoco_export(model)[0].left_out
    assert "no motion" in line.why
    kept = nearest(model, TARGETS["isaaclab"].expressed).model
    assert kept.joints == model.joints


@needs_mujoco
def test_errors_at_the_time_steps_of_users_are_printed_and_written():
    made, _, (agreement,) = mujoco_export(servo(motor=LINE))
    assert [(one["integrator"], one["timestep_s"]) for one in agreement.coarse] == [*CASES]
    assert max(one["error_rad"] for one in agreement.coarse) < 0.02
    assert "Euler, 2 ms: " in str(agreement)
    assert str(agreement) in made.text
