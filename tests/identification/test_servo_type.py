"""Types of servos: what is learned of one servo is the prior of the next."""

import dataclasses
import json

import numpy as np
import pytest

from sim2real.errors import InputError
from sim2real.identification.identify import fitted_motors, identify
from sim2real.identification.servo_type import FOLDER, learn, read_type, write_type
from sim2real.model import JointModel
from sim2real.recording import Load, Recording
from sim2real.robot import Joint, Link, Robot, Servo, read_robot
from sim2real.servo.parameters import joint_row
from sim2real.servo.rollout import rollout

KP, KD, LATENCY, INERTIA = 1.4, 0.07, 0.05, 0.0022
TRUE = {"stall_torque_Nm": 1.2, "no_load_speed_rad_s": 6.5}
SHEET = Servo("hip", 1.67, 5.24, 0.0)
LINK = Link("link", 0.1, 0.1, 0.02, 0.02)


def robot(*names, servo=SHEET):
    return Robot("bench", (LINK,) * (len(names) + 1), tuple(Joint(n, servo) for n in names))


def recorded(sizes, seed=0):
    """One joint a size of the steps; large ones reach the motor's line."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 20.0, 0.02)
    moves = np.searchsorted(np.cumsum(rng.uniform(0.4, 1.0, 40)), t - 0.3)
    levels = rng.uniform(-1, 1, (41, len(sizes))) * sizes
    command = levels[np.minimum(moves, 40)] * (t > 0.3)[:, None]
    row = joint_row(JointModel(KP, KD, LATENCY, INERTIA, law="motor", motor=TRUE), None)
    angle = np.stack([rollout(row[None], t, u)[0] for u in command.T], axis=1)
    angle += rng.normal(0.0, 1e-3, angle.shape)
    names = tuple(f"j{k}" for k in range(len(sizes)))
    return Recording("steps", "servo", names, t, command, angle, {n: Load(INERTIA) for n in names})


def learned():
    motors = fitted_motors([recorded([0.8], seed=1)], robot("j0"))
    return learn("hip", list(motors.values()), "one servo", per_inertia=False)


def test_a_type_is_what_the_fits_told_and_stays_so_on_disk(tmp_path):
    known = learned()
    middle, sd = known.parameters["motor.no_load_speed_rad_s"]
    assert np.exp(middle) == pytest.approx(6.5, rel=0.01)
    assert 0.1 <= sd < 0.15  # the next servo differs more than this one is unsure
    assert "kp_Nm_per_rad" not in known.parameters  # a setting, not of the type
    write_type(known, tmp_path / "hip.json")
    again = read_type(str(tmp_path / "hip.json"))
    assert again.parameters["motor.no_load_speed_rad_s"] == pytest.approx((middle, sd), abs=1e-4)


def test_what_a_quiet_recording_does_not_tell_comes_from_the_type(tmp_path):
    write_type(learned(), tmp_path / "hip.json")
    quiet = recorded([0.05], seed=2)
    typed = dataclasses.replace(SHEET, type=str(tmp_path / "hip.json"))
    plain = identify([quiet], robot("j0")).joints["j0"]
    known = identify([quiet], robot("j0", servo=typed)).joints["j0"]
    assert plain.motor["no_load_speed_rad_s"] == pytest.approx(5.24, rel=0.05)
    assert known.motor["no_load_speed_rad_s"] == pytest.approx(6.5, rel=0.05)


def test_joints_of_one_make_tell_each_other():
    both = recorded([0.05, 0.8], seed=3)
    alone = identify([both], robot("j0", "j1")).joints["j0"]
    helped = identify([both], robot("j0", "j1"), together=True).joints["j0"]
    assert alone.motor["no_load_speed_rad_s"] == pytest.approx(5.24, rel=0.05)
    assert helped.motor["no_load_speed_rad_s"] == pytest.approx(6.5, rel=0.05)
    assert helped.kp_Nm_per_rad == pytest.approx(KP, rel=0.06)  # its steps are 50 times the noise


def test_torques_of_unknown_loads_say_nothing_of_known_ones():
    known = dataclasses.replace(learned(), per_inertia=True)
    assert "motor.stall_torque_Nm" in known.parameters
    motor = fitted_motors([recorded([0.8])], robot("j0"))["j0"]
    generic = motor.problem.prior
    other = known.prior(generic, per_inertia=False)
    stall, fast = (generic.index(f"motor.{n}") for n in TRUE)
    assert other.parameters[stall] == generic.parameters[stall]
    assert other.parameters[fast] != generic.parameters[fast]


def test_a_type_that_is_not_there_is_refused_in_one_line(tmp_path):
    servo = dataclasses.replace(SHEET, type="magic")
    with pytest.raises(InputError, match=r"type.*'magic'.*xl330"):
        identify([recorded([0.3])], robot("j0", servo=servo))
    path = tmp_path / "bad.json"
    path.write_text(json.dumps({"schema": "sim2real.servo_type/1", "parameters": {"x": {}}}))
    with pytest.raises(InputError, match="middle"):
        read_type(str(path))


def test_the_types_that_ship_are_read_and_a_robot_may_name_one(tmp_path):
    for path in FOLDER.glob("*.json"):
        assert read_type(path.stem).parameters
    file = tmp_path / "robot.toml"
    file.write_text(
        '[[joints]]\nname = "j1"\nservo = "hip"\n[servos.hip]\ntype = "xl330"\n'
        "max_torque_Nm = 1.0\nno_load_speed_rad_s = 6.0\n"
    )
    assert read_robot(file).joint("j1").servo.type == "xl330"
