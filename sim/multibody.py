"""A chain of links that floats in the plane: its motion in one step, solved in joint coordinates.

Coordinates: x and y of the head's centre of mass, its heading, the joints' angles. What is carried
from step to step are the links' momenta in the world frame; they are projected on the Jacobian of
the new pose, so no term for centrifugal forces is needed. With M the links' mass less that of the
water inside them, C and p the fluid's sums (``coupling``), V the links' velocities, the new
coordinates' velocities v solve

    sum J' (M + C + B) J v = sum J' ((M + B) V + B (V - V_before) + p) + h T,

where B is a virtual mass on both sides that cancels at constant acceleration; T are the servos'
torques, their gains taken implicitly, and h the step. Dry friction and joint limits are impulses
that can stop a joint but not turn it round, found by projected Gauss-Seidel sweeps (Acary and
Brogliato, Numerical Methods for Nonsmooth Dynamical Systems, Springer, 2008). The virtual mass:
Tavanashad and Subramaniam, Int. J. Multiphase Flow 132 (2020) 103413. All float64, SI.
"""

# ruff: noqa: N806 - the letters of mechanics

import warp as wp

from sim2real.effects import SIGNATURE
from sim2real.servo.law import (
    SENSOR_BITS,
    command_in_force,
    error_seen,
    friction_bound,
    load_torque,
    measured_angle,
    motor_torque,
    pd_torque,
    shaft_inertia,
)

RING = 16
"""Set-points on their way to a joint that are remembered."""
FREE, KINEMATIC, HELD = range(3)
"""Whether servos move the joints, or the joints are prescribed, or the body's motion is too."""
_SWEEPS = 12


@wp.struct
class Chain:
    """Links, joints and servos of E robots; row by row in the shape that is given.

    Attributes:
        mass: Mass and inertia of each link less those of the water inside it, (E, L).
        water: Mass and inertia of that water times the share that is virtual, (E, L).
        com: Distance of the centre of mass from the front end, (E, L).
        length: (L,).
        limits: Smallest and largest angle of each joint, (J,).
        servo: Rows of the servo law's parameters, (E, J, columns).
        active: Effects that are on, (E, J).
        memory: Memory of the effects, (E, J, cells).
        widest: Largest half-width.
    """

    mass: wp.array2d(dtype=wp.vec2d)
    water: wp.array2d(dtype=wp.vec2d)
    com: wp.array2d(dtype=wp.float64)
    length: wp.array(dtype=wp.float64)
    limits: wp.array(dtype=wp.vec2d)
    servo: wp.array3d(dtype=wp.float64)
    active: wp.array2d(dtype=wp.int32)
    memory: wp.array3d(dtype=wp.float64)
    widest: wp.float64


@wp.struct
class Motion:
    """State of E robots with N = 3 + J coordinates and L links.

    Attributes:
        q: Coordinates, (E, N).
        v: Their velocities, (E, N).
        link: Pose of each link's centre of mass: x, y, heading, (E, L).
        twist: Its velocity, (E, L).
        before: Its velocity a step earlier, (E, L).
        force: Force and torque of the fluid on each link in the last step, (E, L).
        torque: Torque of each servo, (E, J).
        impulse: Impulse of dry friction at each joint in the last step, (E, J).
        measured: Angle that each joint's sensor shows, (E, J).
        clock: Seconds since the start, (E,).
        sent, arrival: Set-points on their way and when they arrive, (E, J, RING).
        newest: Number of the newest set-point, (E, J).
        A, b, inverse: Room for the equations, (E, N, N), (E, N) and (E, N, N).
    """

    q: wp.array2d(dtype=wp.float64)
    v: wp.array2d(dtype=wp.float64)
    link: wp.array2d(dtype=wp.vec3d)
    twist: wp.array2d(dtype=wp.vec3d)
    before: wp.array2d(dtype=wp.vec3d)
    force: wp.array2d(dtype=wp.vec3d)
    torque: wp.array2d(dtype=wp.float64)
    impulse: wp.array2d(dtype=wp.float64)
    measured: wp.array2d(dtype=wp.float64)
    clock: wp.array(dtype=wp.float64)
    sent: wp.array3d(dtype=wp.float64)
    arrival: wp.array3d(dtype=wp.float64)
    newest: wp.array2d(dtype=wp.int32)
    A: wp.array3d(dtype=wp.float64)
    b: wp.array2d(dtype=wp.float64)
    inverse: wp.array3d(dtype=wp.float64)


@wp.struct
class OnGrid:
    """The robots as the fluid sees them, in lattice units, and its sums over them."""

    cell: wp.float64
    step: wp.float64
    mass: wp.float64
    origin: wp.vec2d
    margin: int
    corner: wp.array(dtype=wp.vec4i)
    pose: wp.array2d(dtype=wp.vec4)
    centre: wp.array2d(dtype=wp.vec2)
    twist: wp.array2d(dtype=wp.vec4)
    position: wp.array(dtype=wp.vec2)
    sums: wp.array3d(dtype=wp.int64)
    scale: wp.float64


@wp.func
def joint_place(e: int, k: int, chain: Chain, s: Motion) -> wp.vec2d:
    """Where joint k is, which is the front end of link k + 1."""
    pose = s.link[e, k + 1]
    com = chain.com[e, k + 1]
    return wp.vec2d(pose[0] + com * wp.cos(pose[2]), pose[1] + com * wp.sin(pose[2]))


@wp.func
def column(e: int, link: int, i: int, chain: Chain, s: Motion) -> wp.vec3d:
    """Velocity of a link's centre of mass for unit velocity of coordinate i."""
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    if i == 0:
        return wp.vec3d(one, zero, zero)
    if i == 1:
        return wp.vec3d(zero, one, zero)
    at = s.link[e, link]
    if i == 2:
        head = s.link[e, 0]
        return wp.vec3d(head[1] - at[1], at[0] - head[0], one)
    if i - 3 >= link:
        return wp.vec3d(zero, zero, zero)
    pivot = joint_place(e, i - 3, chain, s)
    return wp.vec3d(pivot[1] - at[1], at[0] - pivot[0], one)


@wp.func
def pose_links(e: int, chain: Chain, s: Motion) -> int:
    """Poses of the links from the coordinates."""
    heading = s.q[e, 2]
    ahead = chain.com[e, 0]
    x = s.q[e, 0] + ahead * wp.cos(heading)
    y = s.q[e, 1] + ahead * wp.sin(heading)
    for k in range(chain.length.shape[0]):
        if k > 0:
            heading += s.q[e, 2 + k]
        c = wp.cos(heading)
        d = wp.sin(heading)
        com = chain.com[e, k]
        s.link[e, k] = wp.vec3d(x - com * c, y - com * d, heading)
        x -= chain.length[k] * c
        y -= chain.length[k] * d
    return 0


@wp.func
def move_links(e: int, chain: Chain, s: Motion) -> int:
    """Velocities of the links from those of the coordinates."""
    for k in range(chain.length.shape[0]):
        v = wp.vec3d()
        for i in range(3 + k):
            v += column(e, k, i, chain, s) * s.v[e, i]
        s.twist[e, k] = v
    return 0


@wp.func
def show(e: int, chain: Chain, s: Motion, grid: OnGrid) -> int:
    """Give the fluid the links' poses and velocities, and the cells to look at."""
    low = wp.vec2d(wp.float64(1e30), wp.float64(1e30))
    high = -low
    for k in range(chain.length.shape[0]):
        at = s.link[e, k]
        c = wp.cos(at[2])
        d = wp.sin(at[2])
        com = chain.com[e, k]
        x = (at[0] + com * c - grid.origin[0]) / grid.cell
        y = (at[1] + com * d - grid.origin[1]) / grid.cell
        grid.pose[e, k] = wp.vec4(float(x), float(y), float(c), float(d))
        grid.centre[e, k] = wp.vec2(
            float((at[0] - grid.origin[0]) / grid.cell), float((at[1] - grid.origin[1]) / grid.cell)
        )
        v = s.twist[e, k] * grid.step
        grid.twist[e, k] = wp.vec4(
            float(v[0] / grid.cell), float(v[1] / grid.cell), float(v[2]), 0.0
        )
        back = chain.length[k] / grid.cell
        low = wp.min(low, wp.min(wp.vec2d(x, y), wp.vec2d(x - back * c, y - back * d)))
        high = wp.max(high, wp.max(wp.vec2d(x, y), wp.vec2d(x - back * c, y - back * d)))
    reach = int(wp.ceil(chain.widest / grid.cell)) + grid.margin
    x0 = int(wp.floor(low[0])) - reach
    y0 = int(wp.floor(low[1])) - reach
    grid.corner[e] = wp.vec4i(
        x0, y0, int(wp.ceil(high[0])) + reach + 1 - x0, int(wp.ceil(high[1])) + reach + 1 - y0
    )
    middle = (low + high) * wp.float64(0.5)
    grid.position[e] = wp.vec2(float(middle[0]), float(middle[1]))
    return 0


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
    """Impulse of servo k over a step, the inertia that stands for its gains, and dry friction's.

    The force is that at the middle of the step, as in ``sim2real.servo.law.substep``.
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
    torque = pd_torque(kp, kd, error, v)
    explicit = bool(False)
    if active != 0:
        before = s.torque[e, k]
        error = command_in_force(u, q, v, before, now, h, p, z, active) - q
        error = error_seen(error, q, v, before, now, h, p, z, active)
        load = load_torque(load, q, v, before, now, h, p, z, active)
        torque = pd_torque(kp, kd, error, v)
        if kp > zero:
            made = motor_torque(torque, q, v, torque, now, h, p, z, active)
            explicit = made != torque
            torque = made
        bound = friction_bound(zero, q, v, torque, now, h, p, z, active)
        inertia = shaft_inertia(zero, zero, zero, zero, zero, zero, p, z, active)
    s.torque[e, k] = torque
    rotor = inertia * v
    if explicit:
        return wp.vec3d(h * (torque + load) + rotor, inertia, h * bound)
    gain = half * kd + half * h * kp
    at_start = error + half * v  # less the half step that the new speed will make
    impulse = h * (kp * at_start - wp.float64(0.5) * kd * v + load) + rotor
    return wp.vec3d(impulse, gain + inertia, h * bound)


@wp.func
def factorise(e: int, first: int, size: int, s: Motion) -> int:
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
    return 0


@wp.func
def solve(e: int, size: int, s: Motion) -> int:
    """Replace b by the solution."""
    for i in range(size):
        x = s.b[e, i]
        for k in range(i):
            x -= s.A[e, i, k] * s.b[e, k]
        s.b[e, i] = x / s.A[e, i, i]
    for r in range(size):
        i = size - 1 - r
        x = s.b[e, i]
        for k in range(i + 1, size):
            x -= s.A[e, k, i] * s.b[e, k]
        s.b[e, i] = x / s.A[e, i, i]
    return 0


@wp.func
def response(e: int, column: int, size: int, s: Motion) -> int:
    """Column of the inverse, into ``inverse``."""
    for i in range(size):
        x = wp.float64(0.0)
        if i == column:
            x = wp.float64(1.0)
        for k in range(i):
            x -= s.A[e, i, k] * s.inverse[e, column, k]
        s.inverse[e, column, i] = x / s.A[e, i, i]
    for r in range(size):
        i = size - 1 - r
        x = s.inverse[e, column, i]
        for k in range(i + 1, size):
            x -= s.A[e, k, i] * s.inverse[e, column, k]
        s.inverse[e, column, i] = x / s.A[e, i, i]
    return 0


@wp.func
def stop_joints(
    e: int, size: int, h: wp.float64, friction: wp.array(dtype=wp.float64), chain: Chain, s: Motion
) -> int:
    """Impulses of dry friction and of the joints' limits; ``b`` holds the velocities."""
    J = size - 3
    any_bound = bool(False)
    for k in range(J):
        q = s.q[e, 3 + k] + h * s.b[e, 3 + k]
        if friction[k] > wp.float64(0.0) or q < chain.limits[k][0] or q > chain.limits[k][1]:
            any_bound = True
    if not any_bound:
        return 0
    for k in range(J):
        response(e, 3 + k, size, s)
        s.impulse[e, k] = wp.float64(0.0)
    for _ in range(wp.static(_SWEEPS)):
        for k in range(J):
            v = s.b[e, 3 + k]
            own = s.inverse[e, 3 + k, 3 + k]
            wanted = wp.clamp(s.impulse[e, k] - v / own, -friction[k], friction[k])
            change = wanted - s.impulse[e, k]
            s.impulse[e, k] = wanted
            v += own * change
            low = (chain.limits[k][0] - s.q[e, 3 + k]) / h
            high = (chain.limits[k][1] - s.q[e, 3 + k]) / h
            change += (wp.clamp(v, wp.min(low, wp.max(v, high)), wp.max(high, low)) - v) / own
            for i in range(size):
                s.b[e, i] += s.inverse[e, 3 + k, i] * change
    return 0


@wp.kernel(enable_backward=False)
def start(chain: Chain, s: Motion, grid: OnGrid, mask: wp.array(dtype=wp.int32)):
    """Pose robots as their coordinates say; only where ``mask`` is set."""
    e = wp.tid()
    if mask[e] == 0:
        return
    pose_links(e, chain, s)
    move_links(e, chain, s)
    for k in range(chain.length.shape[0]):
        s.before[e, k] = s.twist[e, k]
        for i in range(7):
            grid.sums[e, k, i] = wp.int64(0)
    show(e, chain, s, grid)


@wp.kernel(enable_backward=False)
def advance(
    chain: Chain,
    s: Motion,
    grid: OnGrid,
    mode: int,
    target: wp.array2d(dtype=wp.float64),
    friction: wp.array2d(dtype=wp.float64),
    stopped: wp.array(dtype=wp.int32),
):
    """One step of robot e; ``target`` holds prescribed velocities of its coordinates."""
    _ = wp.static(SIGNATURE)  # Warp's cache does not see the sources of the effects
    e = wp.tid()
    if stopped[e] >= 0:
        return
    h = grid.step
    L = chain.length.shape[0]
    N = 2 + L
    J = L - 1
    for i in range(N):
        s.b[e, i] = wp.float64(0.0)
        for j in range(i + 1):
            s.A[e, i, j] = wp.float64(0.0)
    unit = grid.mass / grid.scale
    c = grid.cell
    for k in range(L):
        k0 = wp.float64(grid.sums[e, k, 0]) * unit
        kx = wp.float64(grid.sums[e, k, 1]) * unit * c
        ky = wp.float64(grid.sums[e, k, 2]) * unit * c
        kr = wp.float64(grid.sums[e, k, 3]) * unit * c * c
        p = wp.vec3d(
            wp.float64(grid.sums[e, k, 4]) * unit * c / h,
            wp.float64(grid.sums[e, k, 5]) * unit * c / h,
            wp.float64(grid.sums[e, k, 6]) * unit * c * c / h,
        )
        s.force[e, k] = p
        m = chain.mass[e, k]
        w = chain.water[e, k]
        V = s.twist[e, k]
        dV = V - s.before[e, k]
        M = m[0] + w[0]
        inertia = m[1] + w[1]
        r = p + wp.vec3d(
            M * V[0] + w[0] * dV[0], M * V[1] + w[0] * dV[1], inertia * V[2] + w[1] * dV[2]
        )
        for i in range(3 + k):
            a = column(e, k, i, chain, s)
            s.b[e, i] = s.b[e, i] + wp.dot(a, r)
            Ka = wp.vec3d(
                (M + k0) * a[0] - ky * a[2],
                (M + k0) * a[1] + kx * a[2],
                (inertia + kr) * a[2] - ky * a[0] + kx * a[1],
            )
            for j in range(i + 1):
                s.A[e, i, j] = s.A[e, i, j] + wp.dot(Ka, column(e, k, j, chain, s))
    if mode == wp.static(FREE):
        for k in range(J):
            push = drive(e, k, h, chain, s)
            s.b[e, 3 + k] = s.b[e, 3 + k] + push[0]
            s.A[e, 3 + k, 3 + k] = s.A[e, 3 + k, 3 + k] + push[1]
            friction[e, k] = push[2]
        factorise(e, 0, N, s)
        solve(e, N, s)
        stop_joints(e, N, h, friction[e], chain, s)
    else:
        free = int(3)
        if mode == wp.static(HELD):
            free = 0
        for i in range(free):
            for j in range(free, N):
                s.b[e, i] = s.b[e, i] - s.A[e, j, i] * target[e, j]
        factorise(e, 0, free, s)
        solve(e, free, s)
        for j in range(free, N):
            s.b[e, j] = target[e, j]
    finite = bool(True)
    for i in range(N):
        s.v[e, i] = s.b[e, i]
        finite = finite and wp.isfinite(s.b[e, i])
    if not finite:
        stopped[e] = 0
        return
    for k in range(L):
        s.before[e, k] = s.twist[e, k]
    move_links(e, chain, s)
    for k in range(L):
        V = s.twist[e, k]
        k0 = wp.float64(grid.sums[e, k, 0]) * unit
        kx = wp.float64(grid.sums[e, k, 1]) * unit * c
        ky = wp.float64(grid.sums[e, k, 2]) * unit * c
        kr = wp.float64(grid.sums[e, k, 3]) * unit * c * c
        taken = wp.vec3d(
            k0 * V[0] - ky * V[2], k0 * V[1] + kx * V[2], kr * V[2] - ky * V[0] + kx * V[1]
        )
        s.force[e, k] = (s.force[e, k] - taken) / h
        v = V * h
        grid.twist[e, k] = wp.vec4(float(v[0] / c), float(v[1] / c), float(v[2]), 0.0)
        for i in range(7):
            grid.sums[e, k, i] = wp.int64(0)
    s.clock[e] = s.clock[e] + h


@wp.kernel(enable_backward=False)
def move(chain: Chain, s: Motion, grid: OnGrid, stopped: wp.array(dtype=wp.int32)):
    """Carry the coordinates on by one step, once the fluid has answered."""
    e = wp.tid()
    if stopped[e] >= 0:
        return
    for i in range(s.q.shape[1]):
        s.q[e, i] = s.q[e, i] + grid.step * s.v[e, i]
    pose_links(e, chain, s)
    for k in range(s.q.shape[1] - 3):
        if (chain.active[e, k] & wp.static(SENSOR_BITS)) != 0:
            s.measured[e, k] = measured_angle(
                s.q[e, 3 + k], s.q[e, 3 + k], s.v[e, 3 + k], s.torque[e, k], s.clock[e],
                grid.step, chain.servo[e, k], chain.memory[e, k], chain.active[e, k],
            )  # fmt: skip
        else:
            s.measured[e, k] = s.q[e, 3 + k]
    show(e, chain, s, grid)
