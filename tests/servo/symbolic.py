"""The servo's law as a CasADi expression, and simulated angles with exact derivatives by it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from sim2real.arrays import Array
from sim2real.recording import Load

PARAMETERS = ("kp_Nm_per_rad", "kd_Nms_per_rad", "latency_s", "unmodelled_inertia_kgm2")
"""What the derivatives are by, in this order."""

_PHASE_STEP, _DECAY_STEP = 0.2, 0.5
"""Phase in rad and decay in e-folds over one Runge-Kutta step: error below 1e-5 rad (tested)."""
_MOST_STEPS = 8
"""Runge-Kutta steps in one interval before it is cut into parts instead."""
_BLOCK = 64
"""The number of intervals is a multiple of this."""


def pd_torque(kp: ca.SX, kd: ca.SX, error: ca.SX, v: ca.SX) -> ca.SX:
    """Torque of the servo, T = kp (J_des - J) - kd J'. Lin, Liu, Wang (2024), Sec. III-B.2."""
    return kp * error - kd * v


@dataclass(frozen=True)
class Clock:
    """The intervals between events (a sample, a set-point arriving), N in all.

    Attributes:
        length: Lengths in s, shape (N,).
        by_latency: Derivative of the lengths by the latency, shape (N,).
        command: Set-point in force in rad, shape (N,).
        samples: Interval that ends at each sample, shape (T,).
    """

    length: Array
    by_latency: Array
    command: Array
    samples: NDArray[np.int64]

    def refined(self, longest: float) -> Clock:
        """The same clock with longer intervals cut into equal parts, and some of no length added.

        Those at the end round the number of intervals up, so that few sizes ever occur.
        """
        parts = np.maximum(np.ceil(self.length / longest - 1e-9), 1).astype(np.int64)
        ends = np.cumsum(parts)
        idle = np.zeros(-int(ends[-1]) % _BLOCK)
        return Clock(
            length=np.concatenate([np.repeat(self.length / parts, parts), idle]),
            by_latency=np.concatenate([np.repeat(self.by_latency / parts, parts), idle]),
            command=np.concatenate([np.repeat(self.command, parts), idle]),
            samples=ends[self.samples] - 1,
        )


def clock(t: Array, command: Array, latency: float) -> Clock:
    """Cut the time of a recording at samples and at arrivals of set-points.

    Set-points equal to the one before them change nothing and are no events.
    """
    changes = 1 + np.flatnonzero(np.diff(command))
    events = np.concatenate([t, t[changes] + latency])
    arrives = np.concatenate([np.zeros(t.size), np.ones(changes.size)])
    order = np.argsort(events, kind="stable")
    rank = np.empty_like(order)
    rank[order] = np.arange(order.size)
    events, arrives = events[order], arrives[order]
    in_force = np.concatenate([command[:1], command[changes]])
    arrived = np.concatenate([[0], np.cumsum(arrives)[:-1]]).astype(np.int64)
    return Clock(
        length=np.diff(events, prepend=t[0]),
        by_latency=np.diff(arrives, prepend=0.0) * (events >= t[0]),
        command=in_force[arrived],
        samples=rank[: t.size],
    )


def simulate(parameters: Array, load: Load, t: Array, command: Array) -> tuple[Array, Array]:
    """Angles of one servo from rest on its first set-point, and their derivatives.

    Returns:
        Angles in rad, shape (T,), and derivatives by each parameter, shape (T, 4).
    """
    kp, kd, latency, extra = (float(x) for x in parameters)
    inertia, gravity = load.inertia_kgm2, load.gravity_Nm
    events = clock(t, command, latency)
    rate = max(np.sqrt(kp / (inertia + extra)) / _PHASE_STEP, kd / (inertia + extra) / _DECAY_STEP)
    steps = min(int(np.ceil(rate * np.quantile(events.length, 0.9))), _MOST_STEPS)
    events = events.refined(steps / rate)
    start = resting_state(float(command[0]), kp, gravity)
    run = _trajectory(steps, events.length.size)
    inputs = np.stack([events.length, events.by_latency, events.command])
    constants = ca.repmat(ca.DM([kp, kd, extra, inertia, gravity]), 1, events.length.size)
    states = np.asarray(run(start, inputs, constants))[:, events.samples]
    return states[0], states[2::2].T


def resting_state(u: float, kp: float, gravity: float) -> Array:
    """Angle, speed and their derivatives by the parameters, at rest under set-point u: shape (10,).

    The angle solves kp (u - q) = gravity sin q.
    """
    q = u
    for _ in range(50):
        q += (kp * (u - q) - gravity * np.sin(q)) / (kp + abs(gravity * np.cos(q)))
    state = np.zeros(2 + 2 * len(PARAMETERS))
    state[0] = q
    state[2] = (u - q) / (kp + gravity * np.cos(q))
    return state


@lru_cache(maxsize=64)
def _trajectory(steps: int, intervals: int) -> ca.Function:
    return _interval(steps).mapaccum(intervals)


@lru_cache(maxsize=16)
def _interval(steps: int) -> ca.Function:
    """Angle, speed and derivatives over one interval, by ``steps`` Runge-Kutta steps."""
    x, h, u = ca.SX.sym("x", 2), ca.SX.sym("h"), ca.SX.sym("u")
    kp, kd, extra = ca.SX.sym("kp"), ca.SX.sym("kd"), ca.SX.sym("extra")
    inertia, gravity, by_latency = ca.SX.sym("I"), ca.SX.sym("G"), ca.SX.sym("c")

    def slope(x: ca.SX) -> ca.SX:
        torque = pd_torque(kp, kd, u - x[0], x[1]) - gravity * ca.sin(x[0])
        return ca.vertcat(x[1], torque / (inertia + extra))

    after, step = x, h / steps
    for _ in range(steps):
        k1 = slope(after)
        k2 = slope(after + step / 2 * k1)
        k3 = slope(after + step / 2 * k2)
        k4 = slope(after + step * k3)
        after = after + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    by = ca.SX.sym("by", 2, len(PARAMETERS))
    direct = ca.jacobian(after, ca.vertcat(kp, kd, h, extra))
    direct[:, 2] *= by_latency
    state = ca.vertcat(x, ca.vec(by))
    result = ca.vertcat(after, ca.vec(ca.jacobian(after, x) @ by + direct))
    inputs = [state, ca.vertcat(h, by_latency, u), ca.vertcat(kp, kd, extra, inertia, gravity)]
    return ca.Function("interval", inputs, [ca.cse(result)])
