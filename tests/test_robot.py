import pickle
import re
from dataclasses import FrozenInstanceError
from pathlib import Path

import pytest

from sim2real.errors import InputError
from sim2real.robot import Link, Servo, read_robot

FISH = """
name = "two-joint fish"

[[links]]
name = "head"
mass_kg = 0.52
length_m = 0.20
width_m = 0.13
height_m = 0.12
material = "abs"
com_m = 0.10
inertia_kgm2 = 0.002

[[links]]
name = "body"
mass_kg = 1
length_m = 0.1

[[links]]
name = "tail"
com_m = 0

[[joints]]
name = "j1"
servo = "lx824"
limits_rad = [-0.80, 0.80]

[[joints]]
name = "j2"
servo = "small"
limits_rad = [0, 1]

[servos.lx824]
max_torque_Nm = 1.67
no_load_speed_rad_s = 5.24
position_step_rad = 0.00419

[servos.small]
max_torque_Nm = 0.5
no_load_speed_rad_s = 9
position_step_rad = 0
"""


def test_fields_of_a_robot(tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    path.write_text(FISH)
    robot = read_robot(path)
    assert (robot.name, robot.path) == ("two-joint fish", path)
    assert [link.name for link in robot.links] == ["head", "body", "tail"]
    assert robot.links[0] == Link("head", 0.52, 0.2, 0.13, 0.12, "abs", 0.1, 0.002)
    assert robot.links[1] == Link("body", 1, 0.1)
    assert robot.links[2].com_m == 0
    assert [joint.name for joint in robot.joints] == ["j1", "j2"]
    assert robot.joints[0].servo == Servo("lx824", 1.67, 5.24, 0.00419)
    assert robot.joints[1].servo == Servo("small", 0.5, 9, 0)
    assert robot.joints[1].limits_rad == (0, 1)
    assert robot.joint("j2") is robot.joints[1]
    assert robot.joint("j3") is None


BENCH = """
[[joints]]
name = "j1"
servo = "small"
[servos.small]
max_torque_Nm = 0.5
"""


def test_a_bench_states_only_what_is_used(tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    path.write_text(BENCH)
    robot = read_robot(path)
    assert robot.joints[0].servo.max_torque_Nm == 0.5
    assert robot.name == "robot"  # none is stated
    assert [link.name for link in robot.links] == ["link0", "link1"]
    for use, place in (
        (lambda: robot.links[1].mass_kg, "links[1].mass_kg: found nothing, expected a number"),
        (lambda: robot.joints[0].limits_rad, "joints[0].limits_rad: found nothing, expected two"),
        (lambda: robot.joints[0].servo.position_step_rad, "servos.small.position_step_rad: found"),
    ):
        with pytest.raises(InputError, match=re.escape(f"{path}: {place}")):
            use()


def test_the_type_of_a_servo_is_ignored_with_a_warning(tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    path.write_text(BENCH)
    robot = read_robot(path)
    path.write_text(BENCH + 'type = "xl330"\n')
    with pytest.warns(UserWarning, match=re.escape(f"{path}: servos.small.type is ignored")):
        assert read_robot(path).joints == robot.joints


def test_robots_compare_and_travel(tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    path.write_text(BENCH)
    robot = read_robot(path)
    assert pickle.loads(pickle.dumps(robot)) == robot
    assert Link("a") != robot.links[0] == Link("link0") != Link("link0", mass_kg=1.0)
    assert repr(robot.links[0]) == "Link(name='link0')"
    assert len({*robot.links, Link("link1")}) == 2
    with pytest.raises(FrozenInstanceError):
        robot.links[0].mass_kg = 1.0
