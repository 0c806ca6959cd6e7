"""Arms: loads by the multibody library, the coupled rollout, and identification."""

from dataclasses import replace

import numpy as np
import pytest
from arm.pendulum import (
    ARM,
    KD,
    KP,
    LATENCY,
    NOISE,
    ROTOR,
    URDF,
    commands,
    leg,
    mass_matrix,
    motion,
    other_torques,
    recording,
)

from sim2real import verbs
from sim2real.arm.arm_loads import measured_motion, with_arm_loads
from sim2real.arm.description import Multibody
from sim2real.errors import InputError
from sim2real.model import FittedEffect, JointModel, Model, read_model, write_model
from sim2real.recording import Load


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    return leg(tmp_path_factory.mktemp("leg"))


def servo(j):
    rotor = (FittedEffect("unmodelled_inertia", {"inertia_kgm2": ROTOR}),)
    return JointModel(KP[j], KD[j], LATENCY, 0.01, effects=rotor)


def true_model(robot):
    return Model({"hip": servo(0), "knee": servo(1)}, arm=robot.arm)


def test_loads_are_those_of_the_equations_of_motion(robot):
    rng = np.random.default_rng(0)
    q, v, a = rng.normal(0, 1, (3, 20, 2))
    multibody = Multibody(robot.arm)
    inertia, torque = multibody.loads(q, v, a)
    for k in range(20):
        mass = mass_matrix(q[k])
        total = mass @ a[k] + other_torques(q[k], v[k])
        assert inertia[k] == pytest.approx(np.diag(mass), rel=1e-9)
        assert torque[k] == pytest.approx(inertia[k] * a[k] - total, rel=1e-9, abs=1e-12)
        assert multibody.mass_matrix(q[k : k + 1])[0] == pytest.approx(mass, rel=1e-9)


def test_recorded_angles_may_count_from_elsewhere_and_backwards(robot, tmp_path):
    turned = leg(tmp_path, ARM + "\njoints.knee = { direction = -1, zero_rad = 0.3 }")
    q, v, a = np.random.default_rng(1).normal(0, 1, (3, 5, 2))
    sign, zero = np.array([1, -1]), np.array([0, 0.3])
    inertia, torque = Multibody(robot.arm).loads(q, v, a)
    seen = Multibody(turned.arm).loads(sign * q + zero, sign * v, sign * a)
    assert seen[0] == pytest.approx(inertia)
    assert seen[1] == pytest.approx(sign * torque)


def test_the_coupled_rollout_is_the_solution_of_the_equations_of_motion(robot):
    t, sent = commands(3, 3.0)
    command = dict(zip(("hip", "knee"), sent.T, strict=True))
    predicted = np.stack(list(predict(true_model(robot), t, command).values()), axis=1)
    truth = motion(t, sent)
    assert np.abs(truth - sent).max() > 0.3
    assert predicted == pytest.approx(truth, abs=5e-4)


def predict(model, t, command):
    from sim2real.servo.prediction import predict as predict_angles

    return predict_angles(model, t, command)


def test_an_arm_whose_gears_have_play(robot):
    t, sent = commands(4, 3.0)
    command, gap = dict(zip(("hip", "knee"), sent.T, strict=True)), 0.02
    play = FittedEffect("backlash", {"gap_rad": gap})
    loose = {n: replace(s, effects=(*s.effects, play)) for n, s in true_model(robot).joints.items()}
    tight = predict(true_model(robot), t, command)
    for name, angle in predict(Model(loose, arm=robot.arm), t, command).items():
        at_rest = slice(0, 10)  # the weight keeps the output on one flank
        shift = np.abs(angle - tight[name])[at_rest]
        assert shift == pytest.approx(gap / 2, rel=0.2)
        assert np.abs(angle - tight[name]).max() < 5 * gap


def test_a_joint_that_follows_its_command_loads_the_others(robot):
    t, sent = commands(3, 2.0)
    model = replace(true_model(robot), joints={"hip": servo(0)})
    weight = []
    for knee in (0.0, 1.5):
        command = {"hip": sent[:, 0], "knee": np.full(t.size, knee)}
        weight.append(predict(model, t, command)["hip"][5])
    assert abs(weight[0] - weight[1]) > 0.01
    with pytest.raises(InputError, match="joint knee"):
        predict(model, t, {"hip": sent[:, 0], "knee": sent[:, 1]})


@pytest.fixture(scope="module")
def recordings():
    return [recording(1, "a"), recording(2, "b")]


@pytest.fixture(scope="module")
def model(robot, recordings):
    return verbs.identify(recordings, robot, law="pd")


def test_identification_of_joints_that_load_one_another(robot, recordings, model):
    alone = verbs.identify(recordings, replace(robot, arm=None), law="pd")
    for j, name in enumerate(("hip", "knee")):
        joint, signal = model.joints[name], f"{name}.position_rad"
        assert joint.kp_Nm_per_rad == pytest.approx(KP[j], rel=0.03)
        assert joint.kd_Nms_per_rad == pytest.approx(KD[j], rel=0.05)
        assert joint.latency_s == pytest.approx(LATENCY, abs=0.001)
        (rotor,) = joint.effects
        assert rotor.parameters["inertia_kgm2"] == pytest.approx(ROTOR, rel=0.1)
        assert model.fit[signal]["heldout"] < 1.3 * NOISE
        assert alone.fit[signal]["heldout"] > 5 * NOISE


def test_the_model_file_has_the_arm(robot, recordings, model, tmp_path):
    write_model(model, tmp_path / "model.json")
    restored = read_model(tmp_path / "model.json")
    assert restored.arm.joints == robot.arm.joints
    assert "absent.stl" not in restored.arm.urdf
    (measured,) = verbs.predict(recordings[:1], None, restored).angles
    assert measured == pytest.approx(motion(recordings[0].t, recordings[0].command), abs=0.003)


def test_loads_follow_from_the_measured_motion(robot, recordings):
    smooth = measured_motion(recordings[0], robot.arm)
    (loaded,) = with_arm_loads(recordings[:1], robot)
    inertia, _ = Multibody(robot.arm).loads(smooth.angle, smooth.velocity, smooth.acceleration)
    assert loaded.varying_loads["hip"].inertia_kgm2 == pytest.approx(inertia[:, 0])
    assert with_arm_loads(recordings, replace(robot, arm=None)) == recordings


def test_a_load_beside_the_urdf_is_refused(robot, recordings):
    weighed = replace(recordings[0], loads={"hip": Load(0.01)})
    with pytest.raises(InputError, match=r"loads\.hip: found a load of hip, which the URDF"):
        verbs.identify([weighed], robot)


@pytest.mark.parametrize(
    ("arm", "urdf", "message"),
    [
        ('[arm]\nurdf = "none.urdf"', URDF, "none.urdf: found no such file"),
        (ARM + "\ngravity = 3", URDF, "arm.gravity: found an unknown key"),
        (ARM + "\ngravity_m_s2 = [0, 0]", URDF, "arm.gravity_m_s2: found .*three numbers"),
        (ARM + "\njoints.ankle = {}", URDF, "arm.joints.ankle: found an unknown key"),
        (ARM + "\njoints.hip = { direction = 2 }", URDF, "hip.direction: found 2, expected 1 or"),
        (ARM + '\njoints.hip = { urdf_joint = "hop" }', URDF, "'hop', .*did you mean hip"),
        (ARM + '\njoints.hip = { urdf_joint = "knee" }', URDF, "'knee' twice"),
        (ARM, URDF.replace("<robot", "<robots"), "leg.urdf: found .*"),
    ],
)
def test_a_description_that_is_refused(tmp_path, arm, urdf, message):
    with pytest.raises(InputError, match=message):
        leg(tmp_path, arm, urdf)


def test_links_without_mass_are_refused(tmp_path):
    light = URDF.replace('<mass value="0.2"/>', '<mass value="0"/>')
    with pytest.raises(InputError, match="knee: found no mass and no inertia beyond it"):
        Multibody(leg(tmp_path, urdf=light).arm)
