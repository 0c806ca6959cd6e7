"""A servo that is written into a robot's own MJCF file moves there as ``predict`` says."""

from dataclasses import replace

import numpy as np
import pytest
from exported import TYPICAL, export, joint, servo
from simulated import recording

from sim2real.cli import main
from sim2real.errors import InputError
from sim2real.exporters.mjcf import into_robot, responses
from sim2real.model import Model, write_model
from sim2real.recording import Load

mujoco = pytest.importorskip("mujoco", reason="exported models are run by MuJoCo")
ROBOT = """<!-- mine -->
<mujoco model="arm">
  <option timestep="0.00025" integrator="implicitfast"/>
  <default>
    <default class="stiff">
      <joint damping="2" frictionloss="0.3" armature="0.01" actuatorfrcrange="-0.1 0.1"/>
      <position kp="40" kv="3" forcerange="-0.2 0.2" inheritrange="1"/>
    </default>
  </default>
  <worldbody>
    <body name="base"> <!-- kept -->
      <joint name="lift" axis="0 1 0"/>
      <inertial pos="0.1 0 0" mass="0.3" diaginertia="0.01 0.01 0.01"/>
      <body name="head" childclass="stiff">
        <joint name="pan" axis="1 0 0" range="-60 60"/>
        <inertial pos="0 0 0" mass="0.1" diaginertia="0.002 0.002 0.002"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="head_servo" joint="pan" class="stiff"/>
    <motor name="lift" joint="lift"/>
  </actuator>
  <keyframe>
    <key qpos="0.4 0.1" ctrl="0.1 0"/>
  </keyframe>
</mujoco>
"""
LINE = {"stall_torque_Nm": 0.6, "no_load_speed_rad_s": 4.0, "coulomb_Nm": 0.02}
PLAY = {"backlash": TYPICAL["backlash"] | {"rotor_inertia_kgm2": 0.0007}}
PER_INERTIA = replace(
    joint(Load(1.0), {"stall_torque_Nm": 50.0, "no_load_speed_rad_s": 9.0}, kd=6.0),
    kp_Nm_per_rad=150.0, per_inertia=True, load=None,
)  # fmt: skip


@pytest.mark.parametrize(
    "model",
    [servo(motor=LINE), servo(motor=LINE, **PLAY), Model({"j1": PER_INERTIA})],
    ids=["line and friction", "play", "per inertia"],
)
def test_a_servo_in_ones_own_robot(model, tmp_path):
    file, out = tmp_path / "robot.xml", tmp_path / "out.xml"
    file.write_text(ROBOT)
    write_model(model, tmp_path / "model.json")
    call = ["export-servo", str(tmp_path / "model.json"), "--to", "mujoco", "--into", str(file)]
    assert main([*call, "--joint", "pan", "--out", str(out)]) == 0
    changed = set(ROBOT.splitlines()) - set(out.read_text().splitlines())
    assert sum("keyframe" not in line and "<key" not in line for line in changed) == 2
    robot = mujoco.MjModel.from_xml_path(str(out))
    assert robot.actuator("head_servo").id == 0
    assert robot.actuator_ctrlrange[0] == pytest.approx(np.radians([-60, 60]))
    predicted, there = into_robot(file, out, ["pan"], model).errors["steps"]
    assert there.steps == predicted.steps > 5
    assert there.rise_s == pytest.approx(predicted.rise_s, abs=0.002)
    assert there.overshoot == pytest.approx(predicted.overshoot, abs=0.01)
    assert there.error_rad == pytest.approx(predicted.error_rad, abs=0.001)


def test_the_recorded_steps_are_beside_those_of_the_robot(tmp_path, capsys):
    (tmp_path / "robot.xml").write_text(ROBOT)
    given = ["--into", str(tmp_path / "robot.xml"), "--joint", "pan"]
    assert export(tmp_path, servo(), [recording()], "mujoco", *given) == 0
    *_, limit, recorded, predicted, there = capsys.readouterr().out.splitlines()
    rows = recorded, predicted, there
    assert [row.partition("mrad: ")[2].split(" (")[0] for row in rows] == [
        "steps after 9.0 s", "predict, 0.002 kg m2", "servo.txt, 0.002 kg m2",
    ]  # fmt: skip
    assert "of the file stays (-0.2 0.2 N m)" in limit  # with which it is slower
    rise = [float(row.split()[2]) for row in rows]
    assert abs(rise[0] - rise[1]) < 6 < rise[2] - rise[1]


def test_rise_overshoot_and_error_of_a_step():
    t = 0.001 * np.arange(3000)
    since = np.maximum(t - 0.5, 0.0)
    swing = np.sqrt(1 - 0.3**2)
    decay = np.exp(-0.3 * 20 * since)
    angle = 0.4 * (
        1 - decay * (np.cos(20 * swing * since) + 0.3 / swing * np.sin(20 * swing * since))
    )
    ((rise, overshoot, error),) = responses(t, np.where(t < 0.5, 0.0, 0.41), angle)
    assert overshoot == pytest.approx(np.exp(-np.pi * 0.3 / swing), abs=0.005)
    assert error == pytest.approx(0.01, abs=1e-4)
    assert rise == pytest.approx(1.32 / 20, abs=0.001)  # of a damping ratio of 0.3


@pytest.mark.parametrize(
    ("joint", "robot", "expected"),
    [
        ("lid", ROBOT, "lid: found no such hinge, expected one of lift, pan"),
        ("pan", ROBOT.replace('axis="0 1 0"', 'axis="0 1"'), "an MJCF file that MuJoCo loads"),
        ("pan", ROBOT.replace("mine", "mine -- and"), "XML in UTF-8"),
        (
            "pan",
            ROBOT.replace("<position name", "<!-- pan: identified by sim2real --><position name"),
            "before that",
        ),
    ],
)
def test_robots_that_cannot_have_it(joint, robot, expected, tmp_path):
    (tmp_path / "robot.xml").write_text(robot)
    with pytest.raises(InputError, match=expected):
        into_robot(tmp_path / "robot.xml", tmp_path / "out.xml", [joint], servo())
    assert [path.name for path in tmp_path.iterdir()] == ["robot.xml"]
