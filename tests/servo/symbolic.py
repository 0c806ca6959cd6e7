"""The servo's law as a CasADi expression, and simulated angles with exact derivatives by it."""

from functools import cache

import casadi as ca
import numpy as np

PARAMETERS = ("kp_Nm_per_rad", "kd_Nms_per_rad", "latency_s")
"""What the derivatives are by, in this order."""
STEP_S = 0.002
"""The longest Runge-Kutta step: the phase of the tests' servos turns by at most 0.13 rad in it."""


def pd_torque(kp, kd, error, v):
    """Torque of the servo, T = kp (J_des - J) - kd J'. Lin, Liu, Wang (2024), Sec. III-B.2."""
    return kp * error - kd * v


def simulate(parameters, load, t, command):
    """Angles of one servo from rest on its first set-point, and their derivatives.

    Time is cut at samples, where set-points arrive, and every ``STEP_S``. Set-points equal to the
    one before them change nothing and are no events.

    Returns:
        Angles in rad, shape (T,), and derivatives by each parameter, shape (T, 3).
    """
    kp, kd, latency = map(float, parameters)
    changes = 1 + np.flatnonzero(np.diff(command))
    cuts = np.arange(t[0], t[-1], STEP_S)
    times = np.concatenate([t, cuts, t[changes] + latency])
    arrives = np.repeat([0.0, 0.0, 1.0], [t.size, cuts.size, changes.size])
    order = np.argsort(times, kind="stable")
    times, arrives = times[order], arrives[order]
    in_force = np.append(command[0], command[changes])
    arrived = np.cumsum(np.append(0.0, arrives[:-1])).astype(int)
    inputs = np.stack(
        [np.diff(times, prepend=t[0]), np.diff(arrives, prepend=0.0), in_force[arrived]]
    )
    constants = ca.repmat(ca.DM([kp, kd, load.inertia_kgm2, load.gravity_Nm]), 1, times.size)
    run = _interval().mapaccum(times.size)
    start = resting_state(float(command[0]), kp, load.gravity_Nm)
    states = np.asarray(run(start, inputs, constants))[:, np.argsort(order)[: t.size]]
    return states[0], states[2::2].T


def resting_state(u, kp, gravity):
    """Angle, speed and their derivatives by the parameters, at rest under set-point u: shape (8,).

    The angle solves kp (u - q) = gravity sin q.
    """
    q = u
    for _ in range(50):
        q += (kp * (u - q) - gravity * np.sin(q)) / (kp + abs(gravity * np.cos(q)))
    state = np.zeros(2 + 2 * len(PARAMETERS))
    state[0] = q
    state[2] = (u - q) / (kp + gravity * np.cos(q))
    return state


@cache
def _interval():
    """Angle, speed and derivatives after one Runge-Kutta step.

    Its length h changes with the latency by ``by_latency``.
    """
    x, h, u = ca.SX.sym("x", 2), ca.SX.sym("h"), ca.SX.sym("u")
    kp, kd, by_latency = ca.SX.sym("kp"), ca.SX.sym("kd"), ca.SX.sym("by_latency")
    inertia, gravity = ca.SX.sym("I"), ca.SX.sym("G")

    def slope(x):
        torque = pd_torque(kp, kd, u - x[0], x[1]) - gravity * ca.sin(x[0])
        return ca.vertcat(x[1], torque / inertia)

    k1 = slope(x)
    k2 = slope(x + h / 2 * k1)
    k3 = slope(x + h / 2 * k2)
    k4 = slope(x + h * k3)
    after = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    by = ca.SX.sym("by", 2, len(PARAMETERS))
    direct = ca.jacobian(after, ca.vertcat(kp, kd, h))
    direct[:, 2] *= by_latency
    result = ca.vertcat(after, ca.vec(ca.jacobian(after, x) @ by + direct))
    inputs = [ca.vertcat(x, ca.vec(by)), ca.vertcat(h, by_latency, u)]
    inputs.append(ca.vertcat(kp, kd, inertia, gravity))
    return ca.Function("interval", inputs, [ca.cse(result)])
