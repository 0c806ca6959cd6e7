"""Texts for simulators: each parses, holds the numbers, lists what it lacks."""

import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import MagicMock
from xml.etree import ElementTree

import casadi as ca
import exported
import numpy as np
import pytest
from exported import rms

from sim2real.effects import CATALOGUE
from sim2real.exporters.ranges import TARGETS as RANGES
from sim2real.exporters.simulators import TARGETS, costs
from sim2real.model import JointModel, Model
from sim2real.ranges.entry import Ranges, uniform
from sim2real.recording import Load
from sim2real.robot import read_robot
from sim2real.servo.prediction import predict

ISAACLAB = ("DelayedPDActuatorCfg", "DCMotorCfg", "DCMotor", "DelayedPDActuator")
LINE = {"stall_torque_Nm": 0.5, "no_load_speed_rad_s": 6.25, "coulomb_Nm": 0.04}


def export(target, model, robot=None):
    return TARGETS[target].write(model, robot)


def listed(target, model):
    return [str(line) for line in export(target, model).left_out]


def servo(name="j1", *effects):
    fitted = exported.typical(*effects)
    if "torque_saturation" in fitted:
        fitted["torque_saturation"] = fitted["torque_saturation"] | {"free_damping": 0.0}
    first = exported.joint(Load(0.003), **fitted)
    return Model({name: first, "j2": JointModel(1.1, 0.03, 0.02, 0.002)})


def motor(effects=None, kd=0.09, **more):
    """A motor with a torque-speed line, whose controller damps as well, and dry friction."""
    return exported.servo(motor=LINE | more, kd=kd, **(effects or {}))


@pytest.fixture
def robot():
    return read_robot("datasets/servo_steps/robot.toml")


class Recorded:
    """Stands in for a configuration class: keeps its fields."""

    def __init__(self, **fields):
        self.fields = fields


def recording(*names):
    """Classes of a simulator that keep their fields."""
    return {name: type(name, (Recorded,), {}) for name in names}


def isaaclab_fields(modules, model, robot=None):
    """Fields of the configurations that an exported text makes at 5 ms a step."""
    text = export("isaaclab", model, robot).text
    made = modules(text, isaaclab__actuators=recording(*ISAACLAB))["actuators"](physics_dt=0.005)
    return {name: one.fields | {"class": type(one).__name__} for name, one in made.items()}


def test_isaaclab(robot, modules):
    model = servo("j1", "coulomb_friction", "torque_saturation")
    found = isaaclab_fields(modules, model, robot)
    assert found["j1"] == {
        "class": "DelayedPDActuatorCfg",
        "joint_names_expr": ["j1"],
        "stiffness": 2.2,
        "damping": 0.06,
        "effort_limit": 0.5,  # identified; not the data sheet's 1.67
        "velocity_limit": 5.24,
        "min_delay": 10,
        "max_delay": 10,
        "friction": 0.05,
        "dynamic_friction": 0.05,
    }
    assert found["j2"]["effort_limit"] == 1.67
    assert (found["j2"]["min_delay"], found["j2"]["max_delay"]) == (4, 4)


def test_isaaclab_jitter_is_drawn_between_two_delays(modules):
    model = servo("j1", "latency_jitter")
    fields = isaaclab_fields(modules, model)["j1"]
    assert (fields["min_delay"], fields["max_delay"]) == (8, 12)
    assert any("part of latency_jitter" in line for line in listed("isaaclab", model))
    assert "effort_limit" not in fields


def test_a_current_limit_is_the_largest_torque_at_any_speed():
    model = motor({"torque_saturation": {"limit_Nm": 0.3}})
    text = export("isaaclab", model).text
    assert "'j1': DelayedDCMotorCfg(" in text
    assert "saturation_effort=0.5,\n            effort_limit=0.3," in text
    assert "effort_limit=1," in export("isaaclab", motor()).text  # braking adds the back-EMF
    line = '"saturation_effort": 0.5, "velocity_limit": 6.25, "max_motor_effort": 0.3'
    assert line in export("newton", model).text
    for target in ("isaaclab", "newton"):
        assert not any("torque_saturation" in line for line in listed(target, model))


def test_the_delays_of_isaaclab_are_those_of_its_ranges(modules):
    """The motor's class delays set-points, and both texts say how long in the same way."""

    class IdealPD:
        def compute(self, target):
            return target

    class Delayed(IdealPD):
        def compute(self, target):
            return super().compute(target - 1)

    class Motor(IdealPD):
        def compute(self, target):
            return min(super().compute(target), 5)

    actuators = recording(*ISAACLAB) | {"DCMotor": Motor, "DelayedPDActuator": Delayed}
    space = modules(
        export("isaaclab", motor()).text,
        isaaclab__actuators=actuators,
        isaaclab__utils={"configclass": lambda cls: cls},
    )
    found = space["actuators"](0.005)["j1"]
    assert [found.class_type().compute(x) for x in (3, 9)] == [2, 5]
    entries = (
        uniform("command_latency_s", 0.05, 0.05, "s", ""),
        uniform("j1.kp_Nm_per_rad", 2.0, 2.4, "N m/rad", ""),
    )
    text = RANGES["isaaclab"].write(Ranges(entries)).text
    exec(compile(text[text.index("DELAY_S") : text.index("class ")], "ranges.py", "exec"), space)
    delays = found.fields["min_delay"], found.fields["max_delay"]
    assert space["delay_steps"]("j1", 0.005) == delays == (10, 10)


@pytest.mark.parametrize("target", TARGETS)
def test_no_armature_is_negative(target):
    text = export(target, motor({"unmodelled_inertia": {"inertia_kgm2": -0.0005}})).text
    assert not re.search(r"armature\W{1,4}\s*-", text)


def test_genesis(modules):
    model = servo("j1", "coulomb_friction", "unmodelled_inertia", "torque_saturation")
    space = modules(export("genesis", model).text)
    joints = {"j1": SimpleNamespace(dofs_idx_local=[4]), "j2": SimpleNamespace(dofs_idx_local=[2])}
    entity = MagicMock(**{"get_joint.side_effect": joints.get})
    assert space["set_actuators"](entity) == [4, 2]
    calls = {name: given for name, given, _ in entity.method_calls if name != "get_joint"}
    infinite = float("inf")
    assert calls == {
        "set_dofs_kp": ([2.2, 1.1], [4, 2]),
        "set_dofs_kv": ([0.06, 0.03], [4, 2]),
        "set_dofs_damping": ([0, 0], [4, 2]),
        "set_dofs_armature": ([0.001, 0], [4, 2]),
        "set_dofs_frictionloss": ([0.05, 0], [4, 2]),
        "set_dofs_force_range": ([-0.5, -infinite], [0.5, infinite], [4, 2]),
    }


def test_urdf(robot):
    root = ElementTree.fromstring(export("urdf", servo("j1", "coulomb_friction"), robot).text)
    joint = root.find("joint")
    assert (joint.get("name"), joint.get("type")) == ("j1", "revolute")
    (friction,) = (one.get("friction") for one in joint.iter("dynamics"))
    assert friction == "0.05"
    sheet = {"lower": "-0.8", "upper": "0.8", "effort": "1.67", "velocity": "5.24"}
    assert [limit.attrib for limit in joint.iter("limit")] == [sheet]
    bare = ElementTree.fromstring(export("urdf", servo()).text).findall("joint")
    assert [one.get("type") for one in bare] == ["continuous", "continuous"]


def test_json_has_every_number(robot):
    content = json.loads(export("json", servo("j1", "backlash"), robot).text)
    joint = content["joints"]["j1"]
    assert joint["kp_Nm_per_rad"] == 2.2
    assert joint["inertia_kgm2"] == 0.003
    play = {"gap_rad": 0.03, "rotor_inertia_kgm2": 4e-4, "output_friction_Nm": 0.02}
    play |= {"control_on_output": 0.0, "restitution": 0.0}
    assert joint["effects"] == [{"effect": "backlash", "parameters": play}]
    assert joint["data_sheet"]["max_torque_Nm"] == 1.67
    assert content["joints"]["j2"]["limit_Nm"] is None
    assert not json.loads(export("json", motor(load_friction=0.1)).text)["not_expressed"]


@pytest.mark.parametrize("target", ["isaaclab", "mjlab", "newton", "genesis", "urdf"])
@pytest.mark.parametrize("effect", [effect.name for effect in CATALOGUE])
def test_an_effect_is_in_the_text_or_in_the_list(target, effect):
    without, with_it = (export(target, model) for model in (servo(), servo("j1", effect)))
    more = {str(line) for line in with_it.left_out} - {str(line) for line in without.left_out}
    assert with_it.text != without.text
    for line in more:
        assert line in with_it.text
    expressed, before = (
        {line for line in made.text.splitlines() if not line.lstrip().startswith(("#", "j"))}
        for made in (with_it, without)
    )
    assert expressed != before or any(effect in line or "torque limit" in line for line in more)


@pytest.mark.parametrize("target", TARGETS)
def test_a_name_stays_a_name(target):
    """A joint's name cannot end a comment or a string of the text it stands in."""
    name = "j'\"\n1 --> <x/>\nraise SystemExit"
    text = export(target, servo(name, "backlash")).text
    if target == "usd":
        assert len(re.findall(r'    def PhysicsRevoluteJoint "\w+"', text)) == 2
        assert not re.search("^raise", text, re.MULTILINE)
    elif target in ("isaaclab", "isaaclab-bam", "mjlab", "newton", "genesis"):
        code = "\n".join(line for line in text.splitlines() if not line.startswith("from "))
        exec(compile(code, "exported.py", "exec"), {})
    elif target == "json":
        assert name in json.loads(text)["joints"]
    elif target == "casadi":
        assert ca.StringDeserializer(text).unpack().name() == "servo_j_1_x_raise_SystemExit"
    else:
        assert len(list(ElementTree.fromstring(text).iter("joint"))) >= 2


def test_the_readme_says_what_each_target_expresses():
    text = Path("sim2real/exporters/README.md").read_text()
    rows = [line.strip("| ").split("|") for line in text.splitlines() if line.startswith("| `")]
    targets = ("mujoco", "mjlab", "isaaclab", "isaaclab-bam", "newton", "genesis", "urdf")
    for k, name in enumerate(targets, 1):
        said = {row[0].strip().strip("`") for row in rows if len(row) > k and row[k].strip()}
        has = {part for part in TARGETS[name].has if not part.startswith("motor.")}
        assert said == has - {"torque_saturation"}


def test_mjlab(modules):
    actuator = recording("BuiltinPositionActuatorCfg")
    text = export("mjlab", motor(rotor_inertia_kgm2=0.001, stick_time_s=0.02)).text
    space = modules(text, mjlab__actuator=actuator)
    (found,) = space["actuators"](physics_dt=0.004)
    assert found.fields == {
        "target_names_expr": ("j1",),
        "stiffness": 2.2,
        "damping": pytest.approx(0.01),  # of the controller, within the limit
        "viscous_damping": pytest.approx(0.08),  # back-EMF, beyond it
        "armature": 0.001,
        "frictionloss": 0.04,
        "delay_min_lag": 12,
        "delay_max_lag": 12,
        "effort_limit": 0.5,
    }
    joint = SimpleNamespace()
    space["set_friction"](SimpleNamespace(joint={"j1": joint}.get), 0.004)
    impedance = joint.solimp_friction[0]
    assert joint.solref_friction[0] * impedance / 2 == pytest.approx(0.02)  # stops in 20 ms
    rigid = modules(export("mjlab", motor()).text, mjlab__actuator=actuator)
    rigid["set_friction"](SimpleNamespace(joint={"j1": joint}.get), 0.004)
    assert joint.solref_friction[0] == 0.008  # MuJoCo's shortest, two time steps


def test_a_controller_that_damps_less_than_the_line_is_listed_by_mjlab():
    made = export("mjlab", motor(kd=0.05))
    assert any("clips before the back-EMF" in str(line) for line in made.left_out)
    assert "damping=0.05," in made.text and "viscous_damping=0," in made.text


def test_newton(modules):
    """With the parts of ``newton.ModelBuilder`` that it uses, as in release 1.8."""
    text = export("newton", motor(rotor_inertia_kgm2=0.001)).text
    space = modules(text, newton__actuators=recording("DrivePD", "ClampingDCMotor"))
    stop = ("mujoco:solreffriction", "mujoco:solimpfriction")
    builder = MagicMock(
        joint_label=["robot/base", "robot/j1"], joint_qd_start=[0, 6], joint_q_start=[0, 7],
        joint_target_ke=[5.0] * 7, joint_target_kd=[5.0] * 7,
        joint_armature=[0.0] * 7, joint_friction=[0.0] * 7,
        custom_attributes={name: SimpleNamespace(values={}) for name in stop},
    )  # fmt: skip
    space["add_actuators"](builder, 0.004)
    (((drive,), given),) = builder.add_actuator.call_args_list
    assert drive is space["DrivePD"]
    ((clamp, line),) = given.pop("clamping")
    assert given == {
        "index": 6, "pos_index": 7, "delay_steps": 12, "kp": 2.2, "kd": pytest.approx(0.09),
    }  # fmt: skip
    assert clamp is space["ClampingDCMotor"]
    assert line == {"saturation_effort": 0.5, "velocity_limit": 6.25, "max_motor_effort": 1.0}
    assert builder.joint_target_ke[6] == builder.joint_target_kd[6] == 0
    half_step = 0.5 * 0.004 * LINE["stall_torque_Nm"] / LINE["no_load_speed_rad_s"]
    assert builder.joint_armature[6] == pytest.approx(0.001 + half_step)
    assert builder.joint_friction[6] == 0.04
    assert builder.custom_attributes["mujoco:solreffriction"].values == {6: (0.008, 1.0)}


def apart(joint, torque, dt=0.0002, armature=0.0):
    """RMS difference from `predict` of a shaft on two steps, with a torque of error and speed."""
    t = np.arange(0.0, 2.0, dt)
    command = np.where(t < 0.2, 0.0, np.where(t < 1.0, 1.0, -0.8))
    angle = speed = 0.0
    seen = np.empty(t.size)
    for k, target in enumerate(command):
        seen[k] = angle
        speed += dt * torque(target - angle, speed) / (joint.inertia_kgm2 + armature)
        angle += dt * speed
    return rms(seen - predict(Model({"j1": joint}), t, {"j1": command})["j1"])


def test_a_pd_drive_within_the_line_is_a_drive_that_clips_before_the_back_emf(modules):
    """What Newton and mjlab compute from the exported numbers is the law of the motor."""
    joint = replace(motor(coulomb_Nm=0.0).joints["j1"], latency_s=0.0)
    text = export("newton", Model({"j1": joint})).text
    space = modules(text, newton__actuators=recording("DrivePD", "ClampingDCMotor"))
    drive = space["SERVOS"]["j1"]
    ((_, limit),) = drive["clamping"]

    def torque(error, speed):
        share = speed / limit["velocity_limit"]
        most = min(limit["saturation_effort"] * (1 - share), limit["max_motor_effort"])
        least = max(limit["saturation_effort"] * (-1 - share), -limit["max_motor_effort"])
        return min(max(drive["kp"] * error - drive["kd"] * speed, least), most)

    assert apart(joint, torque) < 0.001
    half_step = 0.5 * 0.002 * drive["unlimited_kd"]
    assert apart(joint, torque, 0.002, half_step) < 0.7 * apart(joint, torque, 0.002)


def bam(modules, model):
    """The configurations that an exported text makes of Isaac Lab's drive at 5 ms a step."""
    classes = recording("BamActuatorCfg", "BamMotorCfg")
    text = export("isaaclab-bam", model).text
    found = modules(text, isaaclab__actuators__actuator_bam_cfg=classes)["actuators"](0.005)
    return {name: one.fields | one.fields["motor"].fields for name, one in found.items()}


CURRENT = {"torque_saturation": {"limit_Nm": 0.3, "free_damping": 0.0}}


@pytest.mark.parametrize(
    "model",
    [motor(kd=0.08, coulomb_Nm=0.0), motor(CURRENT, kd=0.08, coulomb_Nm=0.0), servo(),
     exported.servo(**CURRENT)],
    ids=["line", "current limit", "plain", "limit"],
)  # fmt: skip
def test_the_drive_of_bam_is_the_law_of_the_motor(model, modules):
    joint = replace(model.joints["j1"], latency_s=0.0)
    has = bam(modules, Model({"j1": joint}))["j1"]
    kt, ohm, volt = has["kt"], has["resistance"], has["vin"]

    def torque(error, speed):
        duty, middle = error * has["kp_fw"] * has["error_gain"], kt * speed / volt
        if has["max_current"]:
            span = ohm * has["max_current"] / volt
            duty = min(max(duty, middle - span), middle + span)
        most = has["actuator_effort_limit"]  # by default that at standstill
        return min(max(kt * (volt * min(max(duty, -1), 1) - kt * speed) / ohm, -most), most)

    assert apart(joint, torque) < 0.001


def test_what_else_the_drive_of_bam_has(modules):
    gears = {"motor_friction": 0.1, "stribeck_load_friction": 0.2, "stribeck_speed_rad_s": 0.4}
    play = exported.TYPICAL["backlash"] | {"control_on_output": 1.0}
    model = motor({"backlash": play, "voltage_sag": {"loss_at_full_load": 0.2}}, **gears)
    has = bam(modules, model)["j1"]
    assert (has["model"], has["friction_base"], has["alpha"]) == ("m5", 0.04, 2)
    assert (has["load_friction_motor"], has["load_friction_external_stribeck"]) == (0.1, 0.2)
    assert has["dtheta_stribeck"] == 0.4
    assert has["vin_drop_gain_range"][0] * 2.2 / 2 == pytest.approx(0.2) == 1 - has["vin_min"]
    assert (has["min_delay"], has["max_delay"]) == (10, 10)
    assert has["backlash_joint_template"].format("JOINT") in str(listed("isaaclab-bam", model))
    falling = bam(modules, servo("j1", "stribeck_friction"))["j1"]
    assert (falling["model"], falling["friction_base"], falling["friction_stribeck"]) == (
        "m2", 0.05, 0.05,
    )  # fmt: skip


def test_usd():
    model = motor({"unmodelled_inertia": {"inertia_kgm2": 0.001}})
    text = export("usd", Model({"left/j1": model.joints["j1"]})).text
    assert text.count("{") == text.count("}")
    values = dict(re.findall(r"(newton:\w+) = (.+)", text))
    assert values["newton:targets"] == "</bench/left_j1>"
    shown = {name: float(x) for name, x in values.items() if name != "newton:targets"}
    assert shown == {
        "newton:timeStepsPerSecond": 1000, "newton:armature": 0.00104, "newton:friction": 0.04,
        "newton:kp": 2.2, "newton:kd": 0.09, "newton:saturationEffort": 0.5,
        "newton:velocityLimit": 6.25, "newton:maxMotorEffort": 1.0, "newton:delaySteps": 50,
    }  # fmt: skip
    schemas = re.findall(r'"(Newton\w+API)"', text[text.index("def NewtonActuator") :])
    assert schemas == ["NewtonPDControlAPI", "NewtonDCMotorClampingAPI", "NewtonActuatorDelayAPI"]
    assert "NewtonMaxEffortClampingAPI" in export("usd", exported.servo(**CURRENT)).text


def test_what_whole_steps_and_a_proportional_drive_cost():
    def cost(model):
        return [list(one.errors_rad.values()) for one in costs(model, **both)]

    both = {"whole_steps": True, "proportional": True}
    nothing, none = cost(motor(kd=0.08))  # 50 ms, kd is that of the line
    assert max(*nothing, *none) < 1e-5
    (fine, *coarse), (damping,) = cost(exported.servo(motor=LINE, latency_s=0.0507))
    assert 1e-4 < fine < min(coarse) <= max(coarse) < 0.003  # 51, 50 and 50 ms
    assert damping > 0.002
    assert not costs(exported.servo(), whole_steps=False, proportional=True)
