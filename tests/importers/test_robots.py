"""Robots from URDF."""

import numpy as np
import pytest
from good_input import message

from sim2real.cli import main
from sim2real.importers.urdf import read_urdf, robot_toml
from sim2real.robot import read_robot

# A base, an upper arm of 0.3 m with a plate welded to it, turned by a quarter about x, and a
# forearm. Their masses, centres and inertias are chosen so that the sums are easy by hand.
URDF = """<?xml version="1.0"?>
<robot name="arm">
  <link name="base"><inertial><mass value="2"/>
    <inertia ixx="0.02" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper"/>
    <origin xyz="0 0 0.1" rpy="1.5707963267948966 0 0"/><axis xyz="0 0 2"/>
    <limit lower="-1" upper="1.5" effort="3" velocity="6"/>
  </joint>
  <link name="upper"><inertial><origin xyz="0.1 0 0"/><mass value="1"/>
    <inertia ixx="0.001" iyy="0.004" izz="0.005" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="weld" type="fixed"><parent link="upper"/><child link="plate"/>
    <origin xyz="0.3 0 0"/></joint>
  <link name="plate"><inertial><mass value="1"/>
    <inertia ixx="0" iyy="0" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="elbow" type="continuous">
    <parent link="plate"/><child link="fore"/>
    <origin xyz="0 0 0.05"/><axis xyz="0 0 1"/><limit effort="3" velocity="6"/>
  </joint>
  <link name="fore"><inertial><origin xyz="0.05 0 0"/><mass value="0.5"/>
    <inertia ixx="0.001" iyy="0.001" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial></link>
</robot>
"""


def written(folder, name, text):
    file = folder / name
    file.write_text(text)
    return file


def made(folder, file, *more):
    out = folder / "robot.toml"
    assert main(["robot", "from-urdf", str(file), "--out", str(out), *more]) == 0
    return read_robot(out)


def test_from_urdf(tmp_path, capsys):
    robot = made(tmp_path, written(tmp_path, "arm.urdf", URDF))
    assert robot.name == "arm"
    assert [link.name for link in robot.links] == ["base", "upper", "fore"]
    assert [joint.name for joint in robot.joints] == ["shoulder", "elbow"]
    (shoulder, elbow), (_, upper, fore) = robot.joints, robot.links
    assert shoulder.limits_rad == (-1, 1.5)
    message(lambda: elbow.limits_rad, "robot.toml", "joints[1].limits_rad")
    assert (shoulder.servo.max_torque_Nm, shoulder.servo.no_load_speed_rad_s) == (3, 6)
    assert shoulder.servo is elbow.servo
    assert (upper.mass_kg, fore.mass_kg) == pytest.approx((2, 0.5))
    assert upper.length_m == pytest.approx(0.3)  # across the axis: the 0.05 along it do not count
    assert upper.com_m == pytest.approx(0.2)
    # 0.005 + 0.001 and two masses of 1 kg, 0.1 m from the common centre
    assert upper.inertia_kgm2 == pytest.approx(0.026)
    assert fore.inertia_kgm2 == pytest.approx(0.002)
    message(lambda: fore.length_m, "links[2].length_m", "nothing", "above 0")
    message(lambda: upper.width_m, "links[1].width_m")
    message(lambda: shoulder.servo.position_step_rad, "servo1.position_step_rad")
    printed = capsys.readouterr().out
    for line in ("elbow: limits_rad: not stated", "servo1: position_step_rad", "fore: length_m"):
        assert line in printed
        assert f"# not here: {line}" in (tmp_path / "robot.toml").read_text()


def test_mujoco_reads_the_urdf_alike(tmp_path):
    mujoco = pytest.importorskip("mujoco")
    compiler = '<mujoco><compiler fusestatic="false" balanceinertia="true"/></mujoco>'
    text = URDF.replace('ixx="0" iyy="0"', 'ixx="0.0005" iyy="0.0005"')  # of a plate
    model = mujoco.MjModel.from_xml_string(text.replace("</robot>", f"{compiler}</robot>"))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    tree = read_urdf(written(tmp_path, "arm.urdf", URDF))
    for hinge in tree.hinges:
        assert hinge.axis == pytest.approx(data.joint(hinge.name).xaxis, abs=1e-9)
        assert hinge.origin == pytest.approx(data.joint(hinge.name).xanchor, abs=1e-9)
        body = data.body(hinge.body)
        frame = body.ximat.reshape(3, 3)
        inertia = frame @ np.diag(model.body(hinge.body).inertia) @ frame.T
        assert tree.bodies[hinge.body].com == pytest.approx(body.xipos, abs=1e-9)
        assert tree.bodies[hinge.body].inertia == pytest.approx(inertia, abs=1e-9)


@pytest.mark.parametrize(
    ("values", "kept"),
    [
        ((1000, 6), (False, True)),
        ((3, 1e6), (True, False)),
        ((10, 10), (False, False)),
        ((100, 100), (False, False)),
        ((8.5, 8.5), (True, True)),  # alike, but no round number
    ],
)
def test_placeholders_are_no_data_sheet(tmp_path, capsys, values, kept):
    text = URDF.replace('effort="3" velocity="6"', 'effort="{}" velocity="{}"'.format(*values))
    servo = made(tmp_path, written(tmp_path, "arm.urdf", text)).joints[0].servo
    printed = capsys.readouterr().out
    fields = ("max_torque_Nm", "no_load_speed_rad_s")
    for field, value, stated in zip(fields, values, kept, strict=True):
        assert servo.states(field) == stated
        said = f"servo1: {field}: {value:g}, a placeholder"
        assert printed.count(said) == (0 if stated else 1)


def test_what_a_robot_has_no_place_for_is_named(tmp_path):
    more = '<mimic joint="shoulder"/><dynamics damping="0.1" friction="0.2"/>'
    text = URDF.replace('<axis xyz="0 0 1"/>', f'<axis xyz="0 0 1"/>{more}')
    tree = read_urdf(written(tmp_path, "arm.urdf", text))
    message(lambda: robot_toml(tree, ["wrist"]), "no hinge wrist")
    message(lambda: robot_toml(tree, ["elbow", "elbow"]), "--joints", "each joint once")
    _, notes = robot_toml(tree)
    assert "elbow: its coupling to another joint (mimic): not taken" in notes
    assert "elbow: damping and friction (identify finds them): not taken" in notes


def test_joints_that_branch_get_no_links(tmp_path):
    finger = '<joint name="finger" type="revolute"><parent link="plate"/><child link="tip"/>'
    finger += '<limit lower="0" upper="1" effort="1" velocity="9"/></joint><link name="tip"/>'
    slide = '<joint name="slide" type="prismatic"><parent link="tip"/><child link="end"/></joint>'
    text = URDF.replace("</robot>", f'{finger}{slide}<link name="end"/></robot>')
    file = written(tmp_path, "hand.urdf", text)
    text, notes = robot_toml(read_urdf(file))
    assert any("the joints branch" in note for note in notes)
    assert "slide: a prismatic joint: taken for stiff" in notes
    assert "[[links]]" not in text
    chosen = made(tmp_path, file, "--joints", "shoulder", "finger")
    assert [joint.name for joint in chosen.joints] == ["shoulder", "finger"]
    assert chosen.links[1].mass_kg == pytest.approx(2.5)  # the forearm is stiff


@pytest.mark.parametrize(
    ("spoil", "parts"),
    [
        (lambda s: s[:-9], ("no XML",)),
        (lambda s: s.replace("robot", "sdf"), ("<sdf>", "<robot>")),
        (lambda s: '<!DOCTYPE x [<!ENTITY a "b">]>' + s[22:], ("a document type",)),
        (lambda s: s.replace('child link="fore"', 'child link="ghost"'), ("elbow, child", "ghost")),
        (lambda s: s.replace('child link="fore"', 'child link="upper"'), ("two joints",)),
        (lambda s: s.replace('parent link="base"', 'parent link="fore"'), ("in a ring",)),
        (
            lambda s: s.replace('<link name="fore">', '<link name="x"/><link name="fore">'),
            ("2 links that hang on no joint",),
        ),
        (lambda s: s.replace('xyz="0 0 2"', 'xyz="0 0 0"'), ("shoulder, axis", "no length")),
        (lambda s: s.replace('xyz="0 0 2"', 'xyz="0 0"'), ("axis xyz", "three numbers")),
        (lambda s: s.replace('mass value="2"', 'mass value="1e99"'), ("mass", "within 1e+09")),
        (lambda s: s.replace('<mass value="2"/>', "<mass/>"), ("base, inertial, mass", "a number")),
        (lambda s: s.replace('effort="3"', 'effort="strong"'), ("effort", "'strong'")),
        (lambda s: s.replace("revolute", "fixed").replace("continuous", "fixed"), ("no hinge",)),
        (lambda s: s.replace('<link name="base">', "<link>"), ("no name",)),
    ],
)
def test_bad_urdf(tmp_path, spoil, parts):
    file = written(tmp_path, "arm.urdf", spoil(URDF))
    message(lambda: robot_toml(read_urdf(file)), "arm.urdf", *parts)


def test_nothing_half_written(tmp_path, capsys):
    file = written(tmp_path, "arm.urdf", URDF[:-9])
    out = tmp_path / "robot.toml"
    assert main(["robot", "from-urdf", str(file), "--out", str(out)]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not out.exists()
    assert main(["robot", "from-urdf", str(file), "--out", str(file)]) == 2
    assert file.read_text() == URDF[:-9]
