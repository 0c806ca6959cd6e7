"""The exported MuJoCo model moves as `predict` says, and says what it cannot do."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from simulated import steps

from sim2real.effects import CATALOGUE
from sim2real.errors import InputError
from sim2real.exporters.actuator import LACKS as ACTUATOR_LACKS
from sim2real.exporters.mujoco import HAS, LACKS, expressed, mujoco
from sim2real.exporters.mujoco_bench import simulate
from sim2real.identification.identify import identify
from sim2real.model import FittedEffect, JointModel, Model
from sim2real.recording import Load, read_recording
from sim2real.robot import read_robot
from sim2real.servo.prediction import predict

SERVO_STEPS = Path("datasets/servo_steps")
WITHIN_RAD = 1e-3
TYPICAL = {e.name: {p.name: p.typical for p in e.parameters} for e in CATALOGUE}
TYPICAL["cogging"]["phase_rad"] = 0.7
TYPICAL["compliance"]["compliance_rad_per_Nm"] = 0.03
# At 0.5 MuJoCo's own step makes 1.1 mrad of it, and 0.3 at a fifth of the step.
TYPICAL["presliding_friction"]["damping_ratio"] = 0.2
ROUGH = {"stribeck_friction"}  # expressed, but not within a milliradian at this timestep


def servo(load: Load | None = None, **effects: dict[str, float]) -> Model:
    load = load or Load(0.002)
    fitted = tuple(FittedEffect(name, values) for name, values in effects.items())
    return Model(
        {"j1": JointModel(2.2, 0.06, 0.0507, load.inertia_kgm2, load=load, effects=fitted)}
    )


def commands() -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Ten seconds at 50 Hz with jitter: random steps, and a sine that quickens to 1.2 Hz."""
    rng = np.random.default_rng(3)
    t = 0.02 * np.arange(500)
    t[1:] += rng.uniform(-0.002, 0.002, t.size - 1)
    return t, {"steps": steps(t, rng), "sine": 0.5 * np.sin(2 * np.pi * (0.2 + 0.1 * t) * t)}


def apart(model: Model) -> float:
    """RMS difference of MuJoCo and `predict` in rad, the larger of two signals."""
    pytest.importorskip("mujoco", reason="exported models are run by MuJoCo")
    t, signals = commands()
    xml, worst = mujoco(model).text, 0.0
    bare = Model({"j1": JointModel(**(vars(model.joints["j1"]) | {"effects": ()}))})
    for sent in signals.values():
        expected = predict(model, t, {"j1": sent})["j1"]
        start = {"j1": float(predict(bare, t[:2], {"j1": sent[:2]})["j1"][0])}
        seen = simulate(xml, t, {"j1": sent}, start)["j1"]
        worst = max(worst, float(np.sqrt(np.mean((seen - expected) ** 2))))
    return worst


def moved_by(model: Model) -> float:
    """RMS of what the effects of a model change in rad, the larger of two signals."""
    t, signals = commands()
    bare = Model({"j1": JointModel(**(vars(model.joints["j1"]) | {"effects": ()}))})
    both = [[predict(m, t, {"j1": u})["j1"] for m in (model, bare)] for u in signals.values()]
    return max(float(np.sqrt(np.mean((with_it - without) ** 2))) for with_it, without in both)


@pytest.mark.parametrize("load", [Load(0.002), Load(0.004, 0.1, 0.1)], ids=["inertia", "pendulum"])
def test_a_plain_servo(load: Load) -> None:
    assert apart(servo(load)) < WITHIN_RAD


@pytest.mark.parametrize("effect", sorted({*HAS, "torque_saturation"} - ROUGH))
def test_each_effect_that_maps(effect: str) -> None:
    model = servo(**{effect: TYPICAL[effect]})
    assert not mujoco(model).left_out
    assert moved_by(model) > 3 * WITHIN_RAD  # else agreement would show nothing
    assert apart(model) < WITHIN_RAD


def test_rough_friction_is_mostly_there_and_said_to_be_rough() -> None:
    model = servo(stribeck_friction=TYPICAL["stribeck_friction"])
    assert "bristles" in str(*mujoco(model).left_out)
    assert apart(model) < 0.25 * moved_by(model)


@pytest.mark.parametrize(
    "effects",
    [
        ("coulomb_friction", "torque_saturation", "compliance", "unmodelled_inertia"),
        ("rate_limit", "quadratic_drag", "gravity_load", "sensor_gain"),
        ("command_filter", "asymmetric_friction", "torque_saturation", "sensor_offset"),
        ("integral_action", "cogging", "presliding_friction"),
        ("compliance", "torque_saturation", "coulomb_friction", "quadratic_drag"),
        ("backlash", "torque_saturation", "coulomb_friction", "quadratic_drag"),
    ],
)
def test_several_effects_together(effects: tuple[str, ...]) -> None:
    current = {"torque_saturation": TYPICAL["torque_saturation"] | {"free_damping": 0.0}}
    values = TYPICAL | current
    model = servo(Load(0.004, 0.1, 0.1), **{name: values[name] for name in effects})
    assert not mujoco(model).left_out
    assert apart(model) < WITHIN_RAD


@pytest.mark.parametrize("effect", ["compliance", "backlash"])
@pytest.mark.parametrize("of_law", [0.0, 0.0003])
def test_the_rotor_of_a_train_adds_to_the_load(effect: str, of_law: float) -> None:
    load, rotor, beside = Load(0.002), 0.0012, -0.0002
    values = TYPICAL[effect] | {"rotor_inertia_kgm2": rotor}
    model = servo(load, **{effect: values, "unmodelled_inertia": {"inertia_kgm2": beside}})
    joint = replace(model.joints["j1"], law="motor", motor={"rotor_inertia_kgm2": of_law})
    model = Model({"j1": joint})
    world = ElementTree.fromstring(mujoco(model).text).find("worldbody")
    about = {
        body.attrib["name"]: float(body.find("inertial").attrib["diaginertia"].split()[1])
        for body in world.iter("body")
    }
    assert about["j1_link"] == pytest.approx(load.inertia_kgm2 + beside)
    assert about["j1_motor"] == pytest.approx(rotor + of_law)
    assert apart(model) < WITHIN_RAD


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        ("compliance", TYPICAL["compliance"] | {"sensor_on_output": 0.0}),
        ("compliance", TYPICAL["compliance"] | {"sensor_on_output": 1.0}),
        ("unmodelled_inertia", {"inertia_kgm2": -0.0005}),  # the load overstates it
        ("gravity_load", {"torque_Nm": -0.1}),  # a weight that pulls up
    ],
)
def test_other_values(effect: str, values: dict[str, float]) -> None:
    assert apart(servo(**{effect: values})) < WITHIN_RAD


def test_a_servo_identified_from_recordings_on_the_one_held_out() -> None:
    robot = read_robot(SERVO_STEPS / "robot.toml")
    names = ("steps", "sine", "chirp")
    recordings = [read_recording(SERVO_STEPS / f"{name}.csv") for name in names]
    model = identify(recordings, robot)
    chirp = recordings[-1]
    sent = {joint: chirp.command[:, j] for j, joint in enumerate(chirp.joints)}
    expected = predict(model, chirp.t, sent, chirp.loads)
    pytest.importorskip("mujoco", reason="exported models are run by MuJoCo")
    seen = simulate(mujoco(model).text, chirp.t, sent)
    for j, joint in enumerate(chirp.joints):
        assert np.sqrt(np.mean((seen[joint] - expected[joint]) ** 2)) < WITHIN_RAD
        error = [np.nanstd(chirp.position[:, j] - x[joint]) for x in (seen, expected)]
        assert error[0] == pytest.approx(error[1], rel=0.05)  # as near to what was measured


def test_every_effect_is_expressed_or_listed_with_a_reason() -> None:
    for effect in CATALOGUE:
        export = mujoco(servo(**{effect.name: TYPICAL[effect.name]}))
        if effect.name in {*HAS, "torque_saturation"} - ROUGH:
            assert "Everything that was identified is expressed." in export.text
        else:
            (line,) = export.left_out
            assert effect.name in str(line)
            assert str(line) in export.text.replace("- -", "--")
    assert not set(HAS) & set(LACKS)
    assert {e.name for e in CATALOGUE} == {*HAS, *LACKS, *ACTUATOR_LACKS}


def test_what_no_combination_has_is_listed() -> None:
    model = servo(rate_limit=TYPICAL["rate_limit"], command_filter=TYPICAL["command_filter"])
    assert "command_filter (0.03 s)" in str(*mujoco(model).left_out)
    model = servo(rate_limit=TYPICAL["rate_limit"], sensor_offset=TYPICAL["sensor_offset"])
    assert "constant torque" in str(*mujoco(model).left_out)
    sag = FittedEffect("voltage_sag", {"loss_at_full_load": 0.2})
    assert "robot: voltage_sag" in str(*mujoco(Model(servo().joints, effects=(sag,))).left_out)
    model = Model({"j1": JointModel(1100, 30, 0.05, 1.0, per_inertia=True)})
    assert "per kg m2" in str(*mujoco(model).left_out)


def test_the_file_states_limits_integrator_and_time_step() -> None:
    text = mujoco(servo(), read_robot(SERVO_STEPS / "robot.toml")).text
    assert 'range="-0.8 0.8"' in text
    assert '<option timestep="0.00025" integrator="implicitfast"' in text
    assert "implicitfast, 0.25 ms" in text.split("-->")[0]


def test_bad_models() -> None:
    with pytest.raises(InputError, match="at least one identified joint"):
        mujoco(Model({}))
    with pytest.raises(InputError, match="ghost"):
        mujoco(servo(ghost={"x": 1.0}))
    with pytest.raises(InputError, match="j1.backlash: found width, expected one of gap_rad"):
        mujoco(servo(backlash={"width": 1.0}))


def test_bench_names_a_joint_that_is_not_there() -> None:
    pytest.importorskip("mujoco", reason="exported models are run by MuJoCo")
    with pytest.raises(InputError, match="j7.*one of j1"):
        simulate(mujoco(servo()).text, np.array([0.0, 1.0]), {"j7": np.zeros(2)})


def motor(**parameters: float) -> Model:
    """A servo whose drive clips before the back-EMF."""
    joint = servo().joints["j1"]
    object.__setattr__(joint, "law", "motor")
    object.__setattr__(joint, "motor", parameters)
    return Model({"j1": joint})


def test_a_drive_that_clips_before_the_back_emf() -> None:
    model = motor(stall_torque_Nm=0.6, no_load_speed_rad_s=4.0)
    assert not mujoco(model).left_out
    assert apart(model) < WITHIN_RAD
    t, signals = commands()
    sent = {"j1": signals["steps"]}
    clipped = predict(model, t, sent)["j1"] - predict(servo(), t, sent)["j1"]
    assert np.sqrt(np.mean(clipped**2)) > 10 * WITHIN_RAD


@pytest.mark.parametrize("timestep_s", [0.002, 0.005])
def test_damping_below_the_lines_is_as_near_with_eulers_method(timestep_s: float) -> None:
    pytest.importorskip("mujoco", reason="exported models are run by MuJoCo")
    t, signals = commands()
    model = motor(stall_torque_Nm=3.0, no_load_speed_rad_s=12.0, coulomb_Nm=0.05)
    text, errors = mujoco(model).text, {}
    for integrator in ("implicitfast", "Euler"):
        seen = simulate(
            text, t, {"j1": signals["steps"]}, integrator=integrator, timestep_s=timestep_s
        )["j1"]
        expected = predict(model, t, {"j1": signals["steps"]})["j1"]
        errors[integrator] = np.sqrt(np.mean((seen - expected) ** 2))
    assert errors["Euler"] < 1.05 * errors["implicitfast"] < 4 * timestep_s


@pytest.mark.parametrize("free_damping", [0.0, 0.3])
def test_a_current_limit_below_the_torque_speed_line(free_damping: float) -> None:
    model = motor(stall_torque_Nm=0.6, no_load_speed_rad_s=4.0)
    limit = {"limit_Nm": 0.2, "free_damping": free_damping}
    effects = (FittedEffect("torque_saturation", limit),)
    object.__setattr__(model.joints["j1"], "effects", effects)
    assert not mujoco(model).left_out
    assert "torque_saturation" in expressed(model.joints["j1"])
    assert moved_by(model) > 3 * WITHIN_RAD
    assert apart(model) < WITHIN_RAD
    effects += (FittedEffect("compliance", TYPICAL["compliance"]),)
    object.__setattr__(model.joints["j1"], "effects", effects)
    assert "torque_saturation" in str(*mujoco(model).left_out)
    assert "torque_saturation" not in expressed(model.joints["j1"])


@pytest.mark.parametrize("creep_time_s", [0.0, 0.01])
def test_friction_that_stops_the_shaft_softly(creep_time_s: float) -> None:
    hard = motor(coulomb_Nm=0.05)
    soft = motor(coulomb_Nm=0.05, stick_time_s=0.03, creep_time_s=creep_time_s)
    assert not mujoco(soft).left_out
    assert apart(soft) < WITHIN_RAD
    t, signals = commands()
    sent = {"j1": signals["steps"]}
    moved = predict(soft, t, sent)["j1"] - predict(hard, t, sent)["j1"]
    assert np.sqrt(np.mean(moved**2)) > 3 * WITHIN_RAD


def test_a_motor_that_a_pid_must_run_is_listed() -> None:
    model = motor(stall_torque_Nm=0.6, no_load_speed_rad_s=4.0)
    effects = (FittedEffect("rate_limit", TYPICAL["rate_limit"]),)
    object.__setattr__(model.joints["j1"], "effects", effects)
    export = mujoco(model)
    assert "clips before the back-EMF" in str(*export.left_out)
    assert 'kv="0.06"' in export.text
    assert "damping" not in export.text


def test_what_else_the_motor_has_is_expressed_or_listed() -> None:
    terms = {"stall_torque_Nm": 0.6, "rotor_inertia_kgm2": 0.001, "coulomb_Nm": 0.02}
    export = mujoco(motor(**terms, resistance_rise=0.3, load_friction=0.1))
    assert 'armature="0.001"' in export.text
    assert 'frictionloss="0.02"' in export.text
    assert 'damping="0.06"' in export.text  # no speed is known: the gain itself is the back-EMF
    assert [line.what for line in export.left_out] == [
        "motor.resistance_rise (0.3)",
        "motor.load_friction (0.1)",
    ]
    joint = servo().joints["j1"]
    object.__setattr__(joint, "law", "magic")
    with pytest.raises(InputError, match="'magic'.*pd, motor, current_limited"):
        mujoco(Model({"j1": joint}))
