import pickle
import re
from dataclasses import FrozenInstanceError
from pathlib import Path

import pytest
from good_input import ROBOT

from sim2real.errors import InputError
from sim2real.robot import Link, Servo, read_robot

MORE = """
[[links]]
name = "fin"
com_m = 0
[[joints]]
name = "j2"
servo = "small"
limits_rad = [0, 1]
[servos.small]
max_torque_Nm = 0.5
no_load_speed_rad_s = 9
position_step_rad = 0
"""


def test_fields_of_a_robot(tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    head = 'name = "head"\nmaterial = "abs"\ncom_m = 0.10\ninertia_kgm2 = 0.002'
    path.write_text(ROBOT.replace('name = "head"', head) + MORE)
    robot = read_robot(path)
    assert (robot.name, robot.path) == ("fish", path)
    tail, fin = robot.links[1:]
    assert robot.links[0] == Link("head", 0.5, 0.2, 0.1, 0.1, "abs", 0.1, 0.002)
    assert (tail, fin.name, fin.com_m) == (Link("tail", 0.5, 0.2, 0.1, 0.1), "fin", 0)
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
