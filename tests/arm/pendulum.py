"""A double pendulum with servos: its description, and its motion by a textbook's equations."""

import numpy as np
from scipy.integrate import solve_ivp

from sim2real.recording import Recording
from sim2real.robot import read_robot

M1, M2, L1, L2, G = 0.3, 0.2, 0.15, 0.12, 9.80665
KP, KD, ROTOR, NOISE = np.array([6.0, 4.0]), np.array([0.25, 0.15]), 0.004, 0.0008
LATENCY = PERIOD = 0.02

URDF = f"""<robot name="double pendulum">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0 0 {-L1}"/><mass value="{M1}"/>
    <inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial>
    <visual><geometry><mesh filename="absent.stl"/></geometry></visual></link>
  <link name="lower"><inertial><origin xyz="0 0 {-L2}"/><mass value="{M2}"/>
    <inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial></link>
  <joint name="hip" type="continuous"><parent link="base"/><child link="upper"/>
    <axis xyz="0 1 0"/></joint>
  <joint name="knee" type="revolute"><origin xyz="0 0 {-L1}"/><parent link="upper"/>
    <child link="lower"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="5" velocity="5"/></joint>
</robot>"""
ROBOT = """name = "leg"
{arm}
[[joints]]
name = "hip"
servo = "s"
[[joints]]
name = "knee"
servo = "s"
[servos.s]
position_step_rad = 0.0
"""
ARM = '[arm]\nurdf = "leg.urdf"'


def leg(folder, arm=ARM, urdf=URDF):
    """The robot, read from files in a folder."""
    (folder / "leg.urdf").write_text(urdf)
    (folder / "leg.toml").write_text(ROBOT.format(arm=arm))
    return read_robot(folder / "leg.toml")


def mass_matrix(q):
    """M(q) in kg m2, shape (2, 2)."""
    c = np.cos(q[1])
    m12 = M2 * L2**2 + M2 * L1 * L2 * c
    m11 = (M1 + M2) * L1**2 + M2 * L2**2 + 2 * M2 * L1 * L2 * c
    return np.array([[m11, m12], [m12, M2 * L2**2]])


def other_torques(q, v):
    """Coriolis, centrifugal and gravity torques in N m, shape (2,)."""
    h = -M2 * L1 * L2 * np.sin(q[1])
    lower = M2 * G * L2 * np.sin(q[0] + q[1])
    upper = (M1 + M2) * G * L1 * np.sin(q[0]) + lower
    return np.array([h * (2 * v[0] * v[1] + v[1] ** 2) + upper, -h * v[0] ** 2 + lower])


def motion(t, command):
    """Angles (T, 2) of the pendulum with linear servos, from rest on its first set-points."""
    q = command[0].copy()
    for _ in range(100):
        q = command[0] - other_torques(q, np.zeros(2)) / KP
    state, out = np.concatenate([q, np.zeros(2)]), [q]

    def slope(_, y, u):
        q, v = y[:2], y[2:]
        torque = KP * (u - q) - KD * v - other_torques(q, v)
        return np.concatenate([v, np.linalg.solve(mass_matrix(q) + ROTOR * np.eye(2), torque)])

    for k in range(1, t.size):  # a set-point is as late as a sample is long
        u = command[max(k - 2, 0)]
        run = solve_ivp(slope, (t[k - 1], t[k]), state, args=(u,), rtol=1e-7, atol=1e-9)
        state = run.y[:, -1]
        out.append(state[:2])
    return np.array(out)


def commands(seed, seconds):
    """Times (T,) and set-points (T, 2) that step at different times."""
    rng, t = np.random.default_rng(seed), PERIOD * np.arange(round(seconds / PERIOD))
    sent = np.empty((t.size, 2))
    for j in range(2):
        times = 0.3 + np.cumsum(np.append(0.0, rng.uniform(0.3, 0.8, t.size)))
        level = np.append(0.2, rng.uniform(-0.7, 0.7, t.size + 1))
        sent[:, j] = level[np.searchsorted(times, t, side="right")]
    return t, sent


def recording(seed, name, seconds=8.0):
    """What sensors with white noise see of the pendulum."""
    t, sent = commands(seed, seconds)
    noise = np.random.default_rng(100 + seed).normal(0, NOISE, sent.shape)
    return Recording(name, "servo", ("hip", "knee"), t, sent, motion(t, sent) + noise)
