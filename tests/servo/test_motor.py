"""The law of a motor behind gears: its limits, its exact solutions, what recordings tell of it."""

import dataclasses
import json

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from simulated import one_joint, robot

from datasets.servo_steps import make as plant
from sim2real.errors import InputError
from sim2real.identification.identify import identify
from sim2real.identification.problem import ServoProblem
from sim2real.identification.search import robust_order
from sim2real.inference.parameters import Parameter
from sim2real.model import JointModel, Model, read_model, write_model
from sim2real.recording import Load
from sim2real.robot import Servo
from sim2real.servo.parameters import joint_row
from sim2real.servo.rollout import STEPS_PER_RADIAN, rollout
from sim2real.servo.trace import reported_drive

KP, KD, LATENCY, INERTIA = 1.38, 0.068, 0.0617, 0.0022
LINE = {"stall_torque_Nm": 1.6, "no_load_speed_rad_s": 5.2}
FAST = {"stall_torque_Nm": 1.6, "no_load_speed_rad_s": 1.6 / KD}
T = np.arange(0.0, 6.0, 0.02)
SQUARE = np.where((T // 1.0) % 2 > 0, 1.0, 0.0)


def row(load=None, **motor):
    joint = JointModel(KP, KD, LATENCY, INERTIA, law="motor", motor=motor)
    return joint_row(joint, load)


def simulate(command=SQUARE, load=None, accuracy=STEPS_PER_RADIAN, **motor):
    theta = row(load, **motor)[None]
    return rollout(theta, T, command, steps_per_radian=accuracy)[0]


def test_without_limits_it_is_the_linear_servo():
    plain = rollout(row()[None], T, SQUARE)[0]
    far = simulate(stall_torque_Nm=1e6, no_load_speed_rad_s=1e8)
    assert np.abs(far - plain).max() < 5e-5
    assert np.abs(simulate(**LINE) - plain).max() > 0.2


@pytest.mark.parametrize("joint", ["j1", "j2", "j3"])
def test_on_its_line_it_is_the_exact_solution_of_another_program(joint):
    servo = plant.SERVOS[joint]
    command = plant.steps(T, np.random.default_rng(4))
    expected = plant.simulate(servo, T, T, command)[:, 0]
    model = JointModel(
        servo.kp_Nm_per_rad, servo.kd_Nms_per_rad, servo.latency_s, servo.inertia_kgm2,
        law="motor", motor={name: getattr(servo, name) for name in LINE},
    )  # fmt: skip
    found = rollout(joint_row(model, None)[None], T, command)[0]
    np.testing.assert_allclose(found, expected, rtol=0, atol=3e-5)


@pytest.mark.parametrize(
    "motor",
    [
        LINE,
        LINE | {"resistance_rise": 2.0},
        LINE | {"coulomb_Nm": 0.03, "motor_friction": 0.2, "load_friction": 0.15},
        LINE | {"motor_friction": 0.1, "stribeck_motor_friction": 0.2, "stribeck_speed_rad_s": 0.4},
        LINE | {"loop_period_s": 0.01},
    ],
)
def test_it_does_not_depend_on_the_step(motor):
    load = Load(0.0022, 0.2, 0.1)
    coarse = simulate(load=load, **motor)
    fine = simulate(load=load, accuracy=4 * STEPS_PER_RADIAN, **motor)
    assert np.abs(coarse - fine).max() < 4e-4


def test_loss_and_friction_are_the_equations():
    motor = LINE | {"resistance_rise": 1.5, "rotor_inertia_kgm2": 0.001, "coulomb_Nm": 0.02}
    motor |= {"motor_friction": 0.2, "load_friction": 0.3, "stribeck_motor_friction": 0.1}
    motor |= {"stribeck_load_friction": 0.05, "stribeck_speed_rad_s": 0.5}
    load = Load(0.0022, 0.2, 0.1)
    back = 1.6 / 5.2

    def slope(_, state):
        q, v = state
        drive = np.clip(KP * (1.0 - q) - (KD - back) * v, -1.6, 1.6)
        x = drive - back * v
        m = 2 * x / (1 + np.sqrt(1 + 4 * 1.5 * abs(x) / 1.6))
        weight = -load.gravity_Nm * np.sin(q)
        slow = np.exp(-((v / 0.5) ** 2))
        dry = 0.02 + abs(0.2 * m - 0.3 * weight) + slow * abs(0.1 * m - 0.05 * weight)
        return [v, (m + weight - dry) / 0.0032]

    def stops(_, state):
        return state[1] - 1e-3

    stops.terminal, stops.direction = True, -1
    how = {"events": stops, "dense_output": True, "rtol": 1e-10, "atol": 1e-12}
    found = solve_ivp(slope, (0, 1.0), [0, 1e-9], **how)
    t = np.arange(0.0, 0.9 * found.t[-1], 0.002)
    model = JointModel(KP, KD, 0.0, INERTIA, law="motor", motor=motor)
    command = np.where(t > 0, 1.0, 0.0)
    theta = joint_row(model, load)[None]
    # the set-point of 1 rad is sent at the second sample, 2 ms late
    moved = rollout(theta, t, command)[0]
    np.testing.assert_allclose(moved[1:], found.sol(t[1:] - t[1])[0], rtol=0, atol=5e-4)


def test_gears_that_rub_under_load_hold_it():
    held = simulate(np.full(T.size, 0.5), Load(0.0022, 0.5, 0.1), load_friction=2.0)
    assert np.ptp(held) < 1e-3
    moves = simulate(np.where(T > 0.1, 0.5, 0.0), Load(0.0022, 0.5, 0.1))
    assert moves[-1] < 0.48  # the weight pulls the linear servo away from its set-point


def test_a_sampled_loop_is_late_by_half_its_period():
    plain = rollout(row()[None], T, SQUARE)[0]
    sampled = simulate(loop_period_s=0.002)
    more = KP * 0.001  # what the controller sees is half a period old
    earlier = JointModel(KP, KD - more, 0.062, INERTIA)  # its next look after the latency
    alike = rollout(joint_row(earlier, None)[None], T, SQUARE)[0]
    assert np.abs(sampled - alike).max() < 0.5 * np.abs(sampled - plain).max()


def bench(torque=1.67, speed=5.24):
    return robot("j1", servo=Servo("small", torque, speed, 0.0), limits=(-3.0, 3.0))


def recorded(load=None, seed=0, **motor):
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 20.0, 0.01)
    levels = rng.uniform(-1.0, 1.0, 60)
    command = np.interp(t, np.cumsum(rng.uniform(0.2, 0.9, 60)), levels) * (t > 0.3)
    command += np.where((t // 1.7) % 2 > 0, 0.4, 0.0) * (t > 0.3)
    angle = rollout(row(load, **motor)[None], t, command)[0]
    angle += rng.normal(0.0, 1e-3, t.size)
    return one_joint(t, command, angle, load or Load(INERTIA))


def test_the_line_is_found_with_the_gains():
    joint = identify([recorded(**LINE)], bench()).joints["j1"]
    assert joint.law == "motor"
    assert joint.kp_Nm_per_rad == pytest.approx(KP, rel=0.01)
    assert joint.motor["no_load_speed_rad_s"] == pytest.approx(5.2, rel=0.01)
    assert set(joint.motor) == set(LINE)  # nothing that is not there
    low, high = joint.interval["motor.no_load_speed_rad_s"]
    assert low < 5.2 < high


def test_losses_are_found_where_they_are():
    motor = LINE | {"motor_friction": 0.25, "load_friction": 0.15, "rotor_inertia_kgm2": 0.002}
    load = Load(INERTIA, 0.3, 0.1)
    joint = identify([recorded(load, **motor)], bench()).joints["j1"]
    assert joint.motor["motor_friction"] == pytest.approx(0.25, abs=0.05)
    assert joint.motor["rotor_inertia_kgm2"] == pytest.approx(0.002, rel=0.1)
    assert joint.kp_Nm_per_rad == pytest.approx(KP, rel=0.05)


def test_what_recordings_do_not_tell_stays_with_the_data_sheet():
    rng, gentle = np.random.default_rng(1), recorded(**LINE)
    t, command = gentle.t, 0.03 * gentle.command
    angle = rollout(row(**LINE)[None], t, command[:, 0])[0] + rng.normal(0.0, 1e-3, t.size)
    quiet = dataclasses.replace(gentle, command=command, position=angle[:, None])
    joint = identify([quiet], bench()).joints["j1"]
    assert joint.motor["stall_torque_Nm"] == pytest.approx(1.67, rel=0.1)
    assert any("do not determine" in note and "stall torque" in note for note in joint.notes)


def test_a_drive_is_told_from_a_torque():
    t = np.arange(500) / 200.0
    error = 0.6 * np.sin(3.1 * t) + 0.2 * np.sin(11.0 * t)
    position, drive = np.zeros(500), np.clip(2.3 * error, -1, 1)
    assert reported_drive(t, error, position, drive).per_rad == pytest.approx(2.3, rel=0.02)
    for other in (3 * drive, np.roll(drive, 100), np.zeros(500)):
        assert reported_drive(t, error, position, other) is None


def test_a_reported_drive_shows_latency_and_derivative_term():
    t = np.cumsum(np.random.default_rng(3).uniform(0.004, 0.006, 800))
    command, late = (np.sin(3 * x) + 0.3 * np.sin(14 * x) for x in (t, t - 0.005))
    position, speed = 0.8 * np.sin(3 * t - 0.4), 2.4 * np.cos(3 * t - 0.4)
    drive = np.clip(1.5 * (late - position - 0.02 * speed), -1, 1)
    shown = reported_drive(t, command, position, drive)
    assert shown.per_rad == pytest.approx(1.5, rel=0.01)
    assert shown.latency_s == pytest.approx(0.005, abs=0.0005)
    assert shown.lead_s == pytest.approx(0.02, abs=0.002)
    assert shown.period_s == pytest.approx(0.005, rel=0.05)
    alone = reported_drive(t, np.sin(3 * t), position, 1.5 * (np.sin(3 * t) - position))
    assert alone.per_rad == pytest.approx(1.5, rel=0.01)  # one frequency, terms dependent


def test_a_model_file_says_its_law_and_old_ones_mean_pd(tmp_path):
    path = tmp_path / "model.json"
    write_model(Model({"j1": JointModel(KP, KD, LATENCY, INERTIA, law="motor", motor=LINE)}), path)
    content = json.loads(path.read_text())
    assert content["joints"]["j1"]["law"] == "motor"
    assert read_model(path).joints["j1"].motor == LINE
    del content["joints"]["j1"]["law"], content["joints"]["j1"]["motor"]
    path.write_text(json.dumps(content))
    assert read_model(path).joints["j1"].law == "pd"
    content["joints"]["j1"]["law"] = "magic"
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"law.*'magic'.*pd, motor"):
        read_model(path)


def mujoco_joint(t, command, friction):
    """A hinge of MuJoCo with friction loss, its solver's parameters by default, shape (T,)."""
    mujoco = pytest.importorskip("mujoco")
    step = 2e-4
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{step}" integrator="implicitfast"/><worldbody><body>'
        f'<joint name="j" axis="0 1 0" damping="{KD}" frictionloss="{friction}"/>'
        f'<inertial pos="0 0 0" mass="1" diaginertia="{INERTIA} {INERTIA} {INERTIA}"/>'
        f'</body></worldbody><actuator><position joint="j" kp="{KP}"/></actuator></mujoco>'
    )
    data = mujoco.MjData(model)
    data.qpos[0] = command[0]
    times = np.arange(0.0, t[-1] + step, step)
    sent = command[np.maximum(np.searchsorted(t + LATENCY, times, side="right") - 1, 0)]
    angle = np.empty(times.size)
    for k, set_point in enumerate(sent):
        angle[k] = data.qpos[0]
        data.ctrl[0] = set_point
        mujoco.mj_step(model, data)
    return np.interp(t, times, angle)


def stepped(rng, t, simulated):
    """A recording of random steps at times ``t``, simulated from set-points, and noise."""
    levels = rng.uniform(-0.6, 0.6, 80)
    command = levels[np.searchsorted(np.cumsum(rng.uniform(0.3, 0.9, 79)), t - 0.3)] * (t > 0.3)
    angle = simulated(command) + rng.normal(0.0, 5e-4, t.size)
    return one_joint(t, command, angle, Load(INERTIA))


def test_gains_of_a_mujoco_joint_come_back():
    t = np.arange(0.0, 20.0, 0.01)
    made = stepped(np.random.default_rng(3), t, lambda sent: mujoco_joint(t, sent, 0.03))
    model = identify([made], bench(5.0, 5.0 / KD))
    joint, figures = model.joints["j1"], model.fit["j1.position_rad"]
    assert joint.kp_Nm_per_rad == pytest.approx(KP, rel=0.02)
    assert joint.kd_Nms_per_rad == pytest.approx(KD, rel=0.02)
    assert joint.latency_s == pytest.approx(LATENCY, abs=5e-4)
    assert figures["heldout"] < 1.15 * 5e-4


def test_a_loop_whose_looks_set_points_wait_for_is_found():
    motor = FAST | {"loop_period_s": 0.005, "loop_phase_s": 0.0012}
    rng = np.random.default_rng(5)
    t = np.arange(2500) / 97.0 + rng.normal(0.0, 3e-4, 2500)  # the loop keeps other time
    t -= t[0]
    made = stepped(rng, t, lambda sent: rollout(row(**motor)[None], t, sent)[0])
    model = identify([made], bench(1.6, 1.6 / KD))
    joint = model.joints["j1"]
    assert joint.motor["loop_period_s"] == pytest.approx(0.005, rel=1e-3)
    assert joint.kp_Nm_per_rad == pytest.approx(KP, rel=0.02)
    assert joint.kd_Nms_per_rad == pytest.approx(KD, rel=0.03)
    low, high = joint.interval["latency_s"]
    assert low < LATENCY < high and high - low < 0.0051
    assert model.fit["j1.position_rad"]["heldout"] < 1.2 * 5e-4


@pytest.mark.parametrize("odd", [False, True])
def test_a_loop_in_step_with_the_samples_is_said_not_to_be_told(odd):
    rng, t = np.random.default_rng(6), np.arange(1500) / 50.0
    if odd:
        t[1:] += rng.uniform(-0.004, 0.004, t.size - 1)
    made = stepped(rng, t, lambda sent: rollout(row(**FAST)[None], t, sent)[0])
    (joint,) = identify([made], bench(1.6, 1.6 / KD)).joints.values()
    assert "loop_period_s" not in joint.motor
    said = [note for note in joint.notes if "synchronous with their samples" in note]
    assert len(said) == (0 if odd else 1)
    if said:
        assert "at 100 Hz" in said[0]


def test_of_several_minima_the_one_with_the_best_neighbours_comes_first():
    class Problem(ServoProblem):
        """A narrow minimum of 0 at 0.2 and a wide one of 0.1 at 0.6."""

        def residuals(self, x, *, rough=False):
            value = self.values(x)
            narrow = np.minimum(np.abs(value - 0.2) / 0.005, 1.0)
            wide = np.minimum(0.1 + np.abs(value - 0.6), 1.0)
            return np.minimum(narrow, wide)

        def terms(self, x):
            return np.zeros_like(x)

    friction = Parameter("motor.motor_friction", 0.0, 0.9, 0.2, 0.0, 0.4)
    problem = Problem((), row(), (friction,))
    minima = np.array([[0.2], [0.6]]) / 0.2
    assert problem.residuals(minima)[0] < problem.residuals(minima)[1]
    order = robust_order(problem, minima, (0.1, 1.0), np.random.default_rng(0))
    assert list(order) == [1, 0]
