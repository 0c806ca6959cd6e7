"""The exported MuJoCo model moves as `predict` says, and says what it cannot do."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from xml.etree import ElementTree

import exported
import numpy as np
import pytest
from exported import rms
from simulated import steps

from sim2real.effects import CATALOGUE
from sim2real.errors import InputError
from sim2real.exporters.mujoco import HAS, expressed, mujoco
from sim2real.exporters.mujoco_bench import simulate
from sim2real.model import FittedEffect, JointModel, Model
from sim2real.recording import Load
from sim2real.robot import read_robot
from sim2real.servo.prediction import predict

SERVO_STEPS = Path("datasets/servo_steps")
WITHIN_RAD = 1e-3
TYPICAL = exported.TYPICAL | {
    "cogging": exported.TYPICAL["cogging"] | {"phase_rad": 0.7},
    "compliance": exported.TYPICAL["compliance"] | {"compliance_rad_per_Nm": 0.03},
    # At 0.5 MuJoCo's own step makes 1.1 mrad of it, and 0.3 at a fifth of the step.
    "presliding_friction": exported.TYPICAL["presliding_friction"] | {"damping_ratio": 0.2},
}
ROUGH = {"stribeck_friction"}  # expressed, but not within a milliradian at this timestep
LINE = {"stall_torque_Nm": 0.6, "no_load_speed_rad_s": 4.0}
PENDULUM = Load(0.004, 0.1, 0.1)

servo = partial(exported.servo, latency_s=0.0507)


def typical(*names):
    return {name: TYPICAL[name] for name in names}


def commands():
    """Seven seconds at 50 Hz with jitter: random steps, and a sine that quickens to 1.2 Hz."""
    rng = np.random.default_rng(3)
    t = 0.02 * np.arange(350)
    t[1:] += rng.uniform(-0.002, 0.002, t.size - 1)
    return t, {"steps": steps(t, rng), "sine": 0.5 * np.sin(2 * np.pi * (0.2 + 0.14 * t) * t)}


T, SIGNALS = commands()


def predicted(model, signal):
    return predict(model, T, {"j1": SIGNALS[signal]})["j1"]


def apart(model):
    """RMS difference of MuJoCo and `predict` in rad, the larger of two signals."""
    pytest.importorskip("mujoco", reason="exported models are run by MuJoCo")
    xml, errors = mujoco(model).text, []
    bare = Model({"j1": replace(model.joints["j1"], effects=())})
    for name, sent in SIGNALS.items():
        start = {"j1": float(predict(bare, T[:2], {"j1": sent[:2]})["j1"][0])}
        seen = simulate(xml, T, {"j1": sent}, start)["j1"]
        errors.append(rms(seen - predicted(model, name)))
    return max(errors)


def moved_by(model):
    """RMS of what the effects of a model change in rad, the larger of two signals."""
    bare = Model({"j1": replace(model.joints["j1"], effects=())})
    return max(rms(predicted(model, name) - predicted(bare, name)) for name in SIGNALS)


@pytest.mark.parametrize("effect", sorted({*HAS, "torque_saturation"} - ROUGH))
def test_each_effect_that_maps(effect):
    model = servo(**typical(effect))
    assert not mujoco(model).left_out
    assert moved_by(model) > 3 * WITHIN_RAD  # else agreement would show nothing
    assert apart(model) < WITHIN_RAD


def test_rough_friction_is_mostly_there_and_said_to_be_rough():
    model = servo(**typical("stribeck_friction"))
    assert "bristles" in str(*mujoco(model).left_out)
    assert apart(model) < 0.25 * moved_by(model)


@pytest.mark.parametrize(
    "effects",
    [
        ("coulomb_friction", "torque_saturation", "compliance", "unmodelled_inertia"),
        ("rate_limit", "quadratic_drag", "gravity_load", "sensor_gain"),
        ("command_filter", "asymmetric_friction", "torque_saturation", "sensor_offset"),
        ("integral_action", "cogging", "presliding_friction"),
        ("backlash", "torque_saturation", "coulomb_friction", "quadratic_drag"),
    ],
)
def test_several_effects_together(effects):
    values = typical(*effects)
    if "torque_saturation" in values:
        values["torque_saturation"] = values["torque_saturation"] | {"free_damping": 0.0}
    model = servo(PENDULUM, **values)
    assert not mujoco(model).left_out
    assert apart(model) < WITHIN_RAD


@pytest.mark.parametrize("effect", ["compliance", "backlash"])
@pytest.mark.parametrize("of_law", [0.0, 0.0003])
def test_the_rotor_of_a_train_adds_to_the_load(effect, of_law):
    rotor, beside = 0.0012, {"inertia_kgm2": -0.0002}
    train = {effect: TYPICAL[effect] | {"rotor_inertia_kgm2": rotor}}
    model = servo(motor={"rotor_inertia_kgm2": of_law}, **train, unmodelled_inertia=beside)
    world = ElementTree.fromstring(mujoco(model).text).find("worldbody")
    about = {
        body.attrib["name"]: float(body.find("inertial").attrib["diaginertia"].split()[1])
        for body in world.iter("body")
    }
    assert about["j1_link"] == pytest.approx(0.002 - 0.0002)
    assert about["j1_motor"] == pytest.approx(rotor + of_law)
    assert apart(model) < WITHIN_RAD


@pytest.mark.parametrize(
    "model",
    [
        servo(),
        servo(PENDULUM),
        servo(compliance=TYPICAL["compliance"] | {"sensor_on_output": 0.0}),
        servo(compliance=TYPICAL["compliance"] | {"sensor_on_output": 1.0}),
        servo(unmodelled_inertia={"inertia_kgm2": -0.0005}),  # the load overstates it
        servo(gravity_load={"torque_Nm": -0.1}),  # a weight that pulls up
        servo(motor=LINE),  # the drive clips before the back-EMF
    ],
    ids=["plain", "pendulum", "sensor of the motor", "of the output", "inertia", "weight", "line"],
)
def test_other_values(model):
    assert not mujoco(model).left_out
    assert apart(model) < WITHIN_RAD


def test_a_controller_that_sees_the_output_is_lacking():
    for effect in ("backlash", "compliance"):
        model = servo(**{effect: TYPICAL[effect] | {"control_on_output": 1.0}})
        assert effect not in expressed(model.joints["j1"])


def test_flanks_that_rebound():
    play = TYPICAL["backlash"] | {"output_friction_Nm": 0.05}
    assert 'solreflimit="0.0005 1"' in mujoco(servo(backlash=play)).text
    elastic = servo(backlash=play | {"restitution": 0.5})
    ratio = -np.log(0.5) / np.hypot(np.pi, np.log(0.5))
    assert f'solreflimit="{0.0005 / ratio:.9g} {ratio:.9g}"' in mujoco(elastic).text
    assert apart(elastic) < WITHIN_RAD


def test_every_effect_is_expressed_or_listed_with_a_reason():
    for effect in CATALOGUE:
        export = mujoco(servo(**typical(effect.name)))
        if effect.name in {*HAS, "torque_saturation"} - ROUGH:
            assert "Everything that was identified is expressed." in export.text
        else:
            (line,) = export.left_out
            assert effect.name in str(line)
            assert str(line) in export.text.replace("- -", "--")


def test_what_no_combination_has_is_listed():
    sag = FittedEffect("voltage_sag", {"loss_at_full_load": 0.2})
    for model, listed in (
        (servo(**typical("rate_limit", "sensor_offset")), "constant torque"),
        (servo(motor=LINE, **typical("rate_limit")), "clips before the back-EMF"),
        (Model(servo().joints, effects=(sag,)), "robot: voltage_sag"),
        (Model({"j1": JointModel(1100, 30, 0.05, 1.0, per_inertia=True)}), "per kg m2"),
    ):
        assert listed in str(*mujoco(model).left_out)


def test_the_file_states_limits_integrator_and_time_step():
    text = mujoco(servo(), read_robot(SERVO_STEPS / "robot.toml")).text
    assert 'range="-0.8 0.8"' in text
    assert '<option timestep="0.00025" integrator="implicitfast"' in text
    assert "implicitfast, 0.25 ms" in text.split("-->")[0]


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (Model({}), "at least one identified joint"),
        (servo(ghost={"x": 1.0}), "ghost"),
        (
            servo(backlash={"width": 1.0}),
            "j1: backlash: found 'width', expected one of gap_rad, rotor_inertia_kgm2",
        ),
        (Model({"j1": replace(exported.joint(), law="magic")}), "'magic'.*pd, motor, current_lim"),
    ],
)
def test_bad_models(model, message):
    with pytest.raises(InputError, match=message):
        mujoco(model)


def test_bench_names_a_joint_that_is_not_there():
    pytest.importorskip("mujoco", reason="exported models are run by MuJoCo")
    with pytest.raises(InputError, match="j7.*one of j1"):
        simulate(mujoco(servo()).text, np.array([0.0, 1.0]), {"j7": np.zeros(2)})


@pytest.mark.parametrize("timestep_s", [0.002, 0.005])
def test_damping_below_the_lines_is_as_near_with_eulers_method(timestep_s):
    pytest.importorskip("mujoco", reason="exported models are run by MuJoCo")
    line = {"stall_torque_Nm": 3.0, "no_load_speed_rad_s": 12.0, "coulomb_Nm": 0.05}
    model = servo(motor=line)
    text, expected = mujoco(model).text, predicted(model, "steps")

    def error(integrator):
        how = {"integrator": integrator, "timestep_s": timestep_s}
        return rms(simulate(text, T, {"j1": SIGNALS["steps"]}, **how)["j1"] - expected)

    assert error("Euler") < 1.05 * error("implicitfast") < 4 * timestep_s


@pytest.mark.parametrize("free_damping", [0.0, 0.3])
def test_a_current_limit_below_the_torque_speed_line(free_damping):
    limit = {"torque_saturation": {"limit_Nm": 0.2, "free_damping": free_damping}}
    model = servo(motor=LINE, **limit)
    assert not mujoco(model).left_out
    assert "torque_saturation" in expressed(model.joints["j1"])
    assert moved_by(model) > 3 * WITHIN_RAD
    assert apart(model) < WITHIN_RAD
    model = servo(motor=LINE, **limit, **typical("compliance"))
    assert "torque_saturation" not in expressed(model.joints["j1"])


@pytest.mark.parametrize("creep_time_s", [0.0, 0.01])
def test_friction_that_stops_the_shaft_softly(creep_time_s):
    soft = servo(motor={"coulomb_Nm": 0.05, "stick_time_s": 0.03, "creep_time_s": creep_time_s})
    assert not mujoco(soft).left_out
    assert apart(soft) < WITHIN_RAD
    hard = servo(motor={"coulomb_Nm": 0.05})
    assert rms(predicted(soft, "steps") - predicted(hard, "steps")) > 3 * WITHIN_RAD


def test_what_else_the_motor_has_is_expressed():
    terms = {"stall_torque_Nm": 0.6, "rotor_inertia_kgm2": 0.001, "coulomb_Nm": 0.02}
    export = mujoco(servo(motor=terms))
    assert 'armature="0.001"' in export.text
    assert 'frictionloss="0.02"' in export.text
    assert 'damping="0.06"' in export.text  # no speed is known: the gain itself is the back-EMF
