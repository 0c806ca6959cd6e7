"""Joints: set-points, torques, impulses (dry friction, limits), solution of the equations."""

from functools import cache
from typing import Any

import warp as wp

from sim.lattice.cell import BODY, GHOST, Box
from sim.lattice.populations import populations
from sim.lattice.velocities import Lattice
from sim.robot.chain import RING, Chain, Motion, Reals, Reals2
from sim2real.servo import effect_chain as sites
from sim2real.servo.motor import (
    MOTOR_BIT,
    Push,
    gear_friction,
    motor_push,
    pd_torque,
    read_motor,
    resistance,
)

_SWEEPS, _SETTLED = 100, wp.constant(wp.float64(1e-12))
"""Largest number of sweeps, and the change of a joint's rate in rad/s below which they end."""


@wp.func
def factorise(e: int, first: int, size: int, s: Motion) -> None:
    """Cholesky factor of rows ``first`` to ``size``, in place, below the diagonal."""
    for i in range(first, size):
        for j in range(first, i + 1):
            x = s.A[e, i, j]
            for k in range(first, j):
                x -= s.A[e, i, k] * s.A[e, j, k]
            if i == j:
                s.A[e, i, i] = wp.sqrt(x)
            else:
                s.A[e, i, j] = x / s.A[e, j, j]


@wp.func
def solve(size: int, A: Reals2, x: Reals) -> None:
    """Replace x by the solution, with the Cholesky factor of the matrix below the diagonal of A."""
    for i in range(size):
        y = x[i]
        for k in range(i):
            y -= A[i, k] * x[k]
        x[i] = y / A[i, i]
    for r in range(size):
        i = size - 1 - r
        y = x[i]
        for k in range(i + 1, size):
            y -= A[k, i] * x[k]
        x[i] = y / A[i, i]


@wp.func
def set_point(e: int, k: int, start: wp.float64, h: wp.float64, s: Motion) -> wp.float64:
    """Mean over the step of the set-point in force at joint k; NaN where the torque is off."""
    newest = s.newest[e, k]
    mean = wp.float64(0.0)
    until = start + h
    for back in range(wp.static(RING)):
        if newest - back >= 0 and until > start:
            slot = (newest - back) % wp.static(RING)
            since = wp.max(s.arrival[e, k, slot], start)
            if since < until:
                mean += s.sent[e, k, slot] * (until - since) / h
                until = since
    return mean


@wp.func
def drive(e: int, k: int, h: wp.float64, chain: Chain, s: Motion) -> wp.vec3d:
    """Impulse of servo k over a step, equivalent inertia of its gains, bound of dry friction.

    The torque is that at the middle of the step, as in ``sim2real.servo.law.substep``. The friction
    of the gears depends on the motor's torque; the load of the water, unknown before the step, is
    not included.
    """
    p = chain.servo[e, k]
    z = chain.memory[e, k]
    active = chain.active[e, k]
    zero = wp.float64(0.0)
    half = wp.float64(0.5) * h
    kp = p[0]
    kd = p[1]
    v = s.v[e, 3 + k]
    q = s.q[e, 3 + k] + half * v
    now = s.clock[e]
    u = set_point(e, k, now, h, s)
    if wp.isnan(u):
        kp = zero
        kd = zero
        u = q
    error = u - q
    load = zero
    inertia = zero
    bound = zero
    push = Push()
    push.torque = kp * error
    push.damping = kd
    push.stiffness = kp
    torque = pd_torque(kp, kd, error, v)
    explicit = bool(False)
    if active != wp.int64(0):
        before = s.torque[e, k]
        error = sites.command_in_force(u, q, v, before, now, h, p, z, active) - q
        error = sites.error_seen(error, q, v, before, now, h, p, z, active)
        load = sites.load_torque(load, q, v, before, now, h, p, z, active)
        push.torque = kp * error
        if kp > zero and (active & wp.static(wp.int64(MOTOR_BIT))) != wp.int64(0):
            m = read_motor(p)
            push = motor_push(kp, kd, error, v, m)
            factor = wp.float64(1.0) / resistance(push, v, m)
            push.torque *= factor
            push.damping *= factor
            push.stiffness *= factor
        torque = push.torque - push.damping * v
        if kp > zero:
            modified = sites.motor_torque(torque, q, v, torque, now, h, p, z, active)
            explicit = modified != torque
            torque = modified
        bound = sites.friction_bound(zero, q, v, torque, now, h, p, z, active)
        if (active & wp.static(wp.int64(MOTOR_BIT))) != wp.int64(0):
            bound += gear_friction(v, torque, zero, read_motor(p))
        inertia = sites.shaft_inertia(zero, p, z, active)
    s.torque[e, k] = torque
    rotor = inertia * v
    if explicit:
        return wp.vec3d(h * (torque + load) + rotor, inertia, h * bound)
    gain = half * push.damping + half * h * push.stiffness
    at_start = push.torque + push.stiffness * half * v  # without the implicit part
    impulse = h * (at_start - wp.float64(0.5) * push.damping * v + load) + rotor
    return wp.vec3d(impulse, gain + inertia, h * bound)


@wp.func
def stop_joints(e: int, size: int, h: wp.float64, friction: Reals, chain: Chain, s: Motion) -> int:
    """Apply impulses of dry friction and of the joints' limits to the velocities in ``b``."""
    J = size - 3
    any_bound = bool(False)
    for k in range(J):
        q = s.q[e, 3 + k] + h * s.b[e, 3 + k]
        if friction[k] > wp.float64(0.0) or q < chain.limits[k][0] or q > chain.limits[k][1]:
            any_bound = True
    if not any_bound:
        return 0
    for k in range(J):
        for i in range(size):
            s.inverse[e, 3 + k, i] = wp.float64(0.0)
        s.inverse[e, 3 + k, 3 + k] = wp.float64(1.0)
        solve(size, s.A[e], s.inverse[e, 3 + k])
        s.impulse[e, k] = wp.float64(0.0)
        s.stop[e, k] = wp.float64(0.0)
    largest = wp.float64(1.0)
    sweep = int(0)
    while sweep < wp.static(_SWEEPS) and largest > wp.static(_SETTLED):
        largest = wp.float64(0.0)
        sweep += 1
        for k in range(J):
            v = s.b[e, 3 + k]
            mobility = s.inverse[e, 3 + k, 3 + k]
            target = wp.clamp(s.impulse[e, k] - v / mobility, -friction[k], friction[k])
            change = target - s.impulse[e, k]
            s.impulse[e, k] = target
            v += mobility * change
            low = wp.min((chain.limits[k][0] - s.q[e, 3 + k]) / h, wp.float64(0.0))
            high = wp.max((chain.limits[k][1] - s.q[e, 3 + k]) / h, wp.float64(0.0))
            unstopped = v - mobility * s.stop[e, k]
            change -= s.stop[e, k]
            s.stop[e, k] = (wp.clamp(unstopped, low, high) - unstopped) / mobility
            change += s.stop[e, k]
            largest = wp.max(largest, wp.abs(change) * mobility)
            for i in range(size):
                s.b[e, i] += s.inverse[e, 3 + k, i] * change
    return 0


@wp.func
def send_to(e: int, k: int, u: wp.float64, chain: Chain, s: Motion) -> None:
    """Send a set-point to joint k of robot e, which receives it after the latency."""
    number = s.newest[e, k] + 1
    slot = number % wp.static(RING)
    zero = wp.float64(0.0)
    p = chain.servo[e, k]
    now = s.clock[e]
    arrives = now + p[2]
    if chain.active[e, k] != wp.int64(0):
        arrives = sites.arrival_time(
            arrives, wp.float64(number), zero, zero, now, zero, p, chain.memory[e, k],
            chain.active[e, k],
        )  # fmt: skip
    s.sent[e, k, slot] = u + chain.trim[e, k]
    s.arrival[e, k, slot] = arrives
    s.newest[e, k] = number


@wp.kernel(enable_backward=False)
def send(
    command: wp.array2d(dtype=wp.float64),
    chain: Chain,
    s: Motion,
    stopped: wp.array(dtype=wp.int32),
):
    """Send a set-point to joint k of robot e."""
    e, k = wp.tid()
    if stopped[e] < 0:
        send_to(e, k, command[e, k], chain, s)


@wp.kernel(enable_backward=False)
def remember(mask: wp.array(dtype=wp.int32), chain: Chain, s: Motion):
    """Reset the clock of robot e, with its angles as the set-points in force."""
    e = wp.tid()
    if mask[e] == 0:
        return
    s.clock[e] = wp.float64(0.0)
    for k in range(s.newest.shape[1]):
        s.newest[e, k] = 0
        s.sent[e, k, 0] = s.q[e, 3 + k]
        s.arrival[e, k, 0] = wp.float64(-1.0)
        s.torque[e, k] = wp.float64(0.0)
        s.measured[e, k] = s.q[e, 3 + k] - chain.trim[e, k]
        s.strain[e, k] = s.q[e, 3 + k]
        for i in range(chain.memory.shape[2]):
            chain.memory[e, k, i] = wp.float64(0.0)


@cache
def calm(lattice: Lattice, wide: bool) -> Any:  # noqa: ANN401 - Warp has no stubs
    """The kernel that brings boxes to rest."""
    pop = populations(lattice, wide)
    Stored, write = pop.Stored, pop.write

    @wp.kernel(enable_backward=False, module="unique")
    def calm(mask: wp.array(dtype=wp.int32), f: Stored, box: Box):
        e, n = wp.tid()
        if mask[e] == 0:
            return
        cell = e * box.cells + n
        for d in range(wp.static(lattice.Q)):
            write(f, d, cell, box.total, 0.0)
        box.flags[cell] = wp.uint8(int(box.flags[cell]) & wp.static(~(BODY | GHOST) & 255))
        if n == 0:
            box.stopped[e] = -1

    return calm
