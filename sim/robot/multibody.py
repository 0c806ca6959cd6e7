"""A free chain of links in the plane: its motion in one step, solved in joint coordinates.

Coordinates: x and y of the head's centre of mass, its heading, the joints' angles. With M the
links' mass, C, a and p the fluid's sums (``coupling``), P the momentum of the water inside the
links, V their velocities, J the Jacobian of the new pose, T the servos' torques and h the step, the
new coordinates' velocities v solve

    sum J' (M + C + B) J v = sum J' ((M + B) V + B (V - V_before) + p - a - P) + h T.

C is the symmetric part of the sums' matrix; the rest acts on V. Where the water does not slip, M is
less the mass of the water inside, p and P are 0, and B is a virtual mass (Tavanashad and
Subramaniam, Int. J. Multiphase Flow 132 (2020) 103413). Dry friction and limits are impulses by
projected Gauss-Seidel sweeps (Acary and Brogliato, Nonsmooth Dynamical Systems, Springer, 2008).
SI.
"""

import warp as wp

from sim.fluid.coupling import SUMS
from sim.robot.chain import Chain, Motion, OnGrid, Reals2
from sim.robot.joints import drive, factorise, solve, stop_joints
from sim.robot.outside import appendages, carried, held, hold, pull, resist, skin
from sim2real.effects import SIGNATURE
from sim2real.servo.effect_chain import SENSOR_BITS, measured_angle

FREE, KINEMATIC, HELD = range(3)
"""Whether servos move the joints, or the joints are prescribed, or the body's motion is too."""


@wp.func
def column(e: int, link: int, i: int, s: Motion) -> wp.vec3d:
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
    pivot = s.joint[e, i - 3]
    return wp.vec3d(pivot[1] - at[1], at[0] - pivot[0], one)


@wp.func
def pose_links(e: int, chain: Chain, s: Motion) -> None:
    """Poses of the links and positions of the joints from the coordinates."""
    heading = s.q[e, 2]
    com = chain.com[e, 0]
    side = chain.side[e, 0]
    x = s.q[e, 0] + com * wp.cos(heading) + side * wp.sin(heading)
    y = s.q[e, 1] + com * wp.sin(heading) - side * wp.cos(heading)
    for k in range(chain.length.shape[0]):
        if k > 0:
            heading += s.q[e, 2 + k]
            s.joint[e, k - 1] = wp.vec2d(x, y)
        c = wp.cos(heading)
        d = wp.sin(heading)
        com = chain.com[e, k]
        side = chain.side[e, k]
        s.link[e, k] = wp.vec3d(x - com * c - side * d, y - com * d + side * c, heading)
        x -= chain.length[k] * c
        y -= chain.length[k] * d


@wp.func
def move_links(e: int, s: Motion) -> None:
    """Velocities of the links from those of the coordinates."""
    for k in range(s.link.shape[1]):
        v = wp.vec3d()
        for i in range(3 + k):
            v += column(e, k, i, s) * s.v[e, i]
        s.twist[e, k] = v


@wp.func
def show(e: int, chain: Chain, s: Motion, grid: OnGrid) -> None:
    """Set the links' poses and velocities for the fluid, and the range of cells around them."""
    low = wp.vec2d(wp.float64(1e30), wp.float64(1e30))
    high = -low
    for k in range(chain.length.shape[0]):
        at = s.link[e, k]
        c = wp.cos(at[2])
        d = wp.sin(at[2])
        com = chain.com[e, k]
        side = chain.side[e, k]
        x = (at[0] + com * c + side * d - grid.origin[0]) / grid.cell
        y = (at[1] + com * d - side * c - grid.origin[1]) / grid.cell
        grid.body.pose[e, k] = wp.vec4(float(x), float(y), float(c), float(d))
        grid.body.centre[e, k] = wp.vec2(
            float((at[0] - grid.origin[0]) / grid.cell), float((at[1] - grid.origin[1]) / grid.cell)
        )
        v = s.twist[e, k] * grid.step
        grid.body.twist[e, k] = wp.vec4(
            float(v[0] / grid.cell), float(v[1] / grid.cell), float(v[2]), 0.0
        )
        back = chain.length[k] / grid.cell
        low = wp.min(low, wp.min(wp.vec2d(x, y), wp.vec2d(x - back * c, y - back * d)))
        high = wp.max(high, wp.max(wp.vec2d(x, y), wp.vec2d(x - back * c, y - back * d)))
    reach = int(wp.ceil(chain.widest / grid.cell)) + grid.margin
    x0 = int(wp.floor(low[0])) - reach
    y0 = int(wp.floor(low[1])) - reach
    grid.body.corner[e] = wp.vec4i(
        x0, y0, int(wp.ceil(high[0])) + reach + 1 - x0, int(wp.ceil(high[1])) + reach + 1 - y0
    )
    middle = (low + high) * wp.float64(0.5)
    grid.position[e] = wp.vec2(float(middle[0]), float(middle[1]))


@wp.func
def matrix(e: int, k: int, at: int, unit: wp.float64, grid: OnGrid) -> wp.mat33d:
    """A matrix of the fluid's sums over link k, in kg, kg m and kg m2."""
    c = grid.cell
    m = wp.mat33d()
    for i in range(3):
        for j in range(3):
            x = wp.float64(grid.body.sums[e, k, at + 3 * i + j]) * unit
            if i == 2:
                x = x * c
            if j == 2:
                x = x * c
            m[i, j] = x
    return m


@wp.func
def vector(e: int, k: int, at: int, unit: wp.float64, grid: OnGrid) -> wp.vec3d:
    """A vector of the fluid's sums over link k, in N s and N m s."""
    c = grid.cell / grid.step
    return wp.vec3d(
        wp.float64(grid.body.sums[e, k, at]) * unit * c,
        wp.float64(grid.body.sums[e, k, at + 1]) * unit * c,
        wp.float64(grid.body.sums[e, k, at + 2]) * unit * c * grid.cell,
    )


@wp.func
def about(p: wp.vec3d, x: wp.vec3d, sign: wp.float64) -> wp.vec3d:
    """A momentum with its moment taken from a point to the origin (1), or back (-1)."""
    return wp.vec3d(p[0], p[1], p[2] + sign * (x[0] * p[1] - x[1] * p[0]))


@wp.func
def begin(e: int, h: wp.float64, chain: Chain, s: Motion) -> None:
    """Start the equations of a step with the outside forces."""
    for i in range(s.q.shape[1]):
        s.b[e, i] = h * chain.push[e, i]
        for j in range(i + 1):
            s.A[e, i, j] = wp.float64(0.0)


@wp.func
def solve_free(e: int, h: wp.float64, chain: Chain, s: Motion, friction: Reals2) -> None:
    """Add servos and skin to the equations and solve them for joints that move freely."""
    N = s.q.shape[1]
    for k in range(N - 3):
        push = drive(e, k, h, chain, s)
        elastic = skin(e, k, h, chain, s)
        s.b[e, 3 + k] = s.b[e, 3 + k] + push[0] + elastic[0]
        s.A[e, 3 + k, 3 + k] = s.A[e, 3 + k, 3 + k] + push[1] + elastic[1]
        friction[e, k] = push[2]
    factorise(e, 0, N, s)
    solve(N, s.A[e], s.b[e])
    stop_joints(e, N, h, friction[e], chain, s)


@wp.kernel(enable_backward=False)
def start(chain: Chain, s: Motion, grid: OnGrid, mask: wp.array(dtype=wp.int32)):
    """Compute the links' poses and velocities from the coordinates, where ``mask`` is set."""
    e = wp.tid()
    if mask[e] == 0:
        return
    pose_links(e, chain, s)
    move_links(e, s)
    s.fresh[e] = 1
    grid.body.kept[e] = 0.0
    for k in range(chain.length.shape[0]):
        s.before[e, k] = s.twist[e, k]
        hold(e, k, chain, s)
        s.inner[e, k] = wp.vec3d()
        for i in range(wp.static(SUMS)):
            grid.body.sums[e, k, i] = wp.int64(0)
    show(e, chain, s, grid)


@wp.kernel(enable_backward=False)
def advance(
    chain: Chain,
    s: Motion,
    grid: OnGrid,
    mode: int,
    target: Reals2,
    friction: Reals2,
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
    begin(e, h, chain, s)
    unit = grid.mass / grid.scale
    c = grid.cell
    for k in range(L):
        full = matrix(e, k, 0, unit, grid)
        K = wp.float64(0.5) * (full + wp.transpose(full))
        m = chain.mass[e, k]
        w = chain.water[e, k]
        V = s.twist[e, k]
        p = vector(e, k, 21, unit, grid) - vector(e, k, 18, unit, grid)
        if s.fresh[e] == 0:
            p -= about(s.inner[e, k], s.link[e, k], wp.float64(-1.0))
        else:
            p -= vector(e, k, 21, unit, grid)
        p += (K - full) * V
        s.force[e, k] = p
        K += appendages(e, k, h, chain, s) + resist(e, k, h, chain, s)
        dV = V - s.before[e, k]
        M = m[0] + w[0]
        inertia = m[1] + w[1]
        r = p + wp.vec3d(
            M * V[0] + w[0] * dV[0], M * V[1] + w[0] * dV[1], inertia * V[2] + w[1] * dV[2]
        )
        tether = wp.float64(0.0)
        if k == 0:
            r += pull(e, h, chain, s)
            tether = h * h * chain.tether[e][0]
        r += carried(e, k, chain, s) + held(e, k, h, s)
        for i in range(3 + k):
            a = column(e, k, i, s)
            s.b[e, i] = s.b[e, i] + wp.dot(a, r)
            Ka = K * a + wp.vec3d((M + tether) * a[0], (M + tether) * a[1], inertia * a[2])
            for j in range(i + 1):
                s.A[e, i, j] = s.A[e, i, j] + wp.dot(Ka, column(e, k, j, s))
    if mode == wp.static(FREE):
        solve_free(e, h, chain, s, friction)
    else:
        free = int(3)
        if mode == wp.static(HELD):
            free = 0
        for i in range(free):
            for j in range(free, N):
                s.b[e, i] = s.b[e, i] - s.A[e, j, i] * target[e, j]
        factorise(e, 0, free, s)
        solve(free, s.A[e], s.b[e])
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
    move_links(e, s)
    passed = wp.float64(0.0)
    weight = wp.float64(1.0)
    for k in range(L):
        passed += wp.float64(grid.body.sums[e, k, 24])
        weight += wp.float64(grid.body.sums[e, k, 25])
    grid.body.kept[e] = (
        grid.body.kept[e] + (float(passed / weight) - grid.body.kept[e]) / grid.memory
    )
    for k in range(L):
        V = s.twist[e, k]
        hold(e, k, chain, s)
        full = matrix(e, k, 0, unit, grid)
        K = wp.float64(0.5) * (full + wp.transpose(full))
        s.force[e, k] = (s.force[e, k] - K * V) / h
        inner = vector(e, k, 21, unit, grid) + matrix(e, k, 9, unit, grid) * V
        inner += (full - K) * (V - s.before[e, k])
        s.inner[e, k] = about(inner, s.link[e, k], wp.float64(1.0))
        v = V * h
        grid.body.twist[e, k] = wp.vec4(float(v[0] / c), float(v[1] / c), float(v[2]), 0.0)
        for i in range(wp.static(SUMS)):
            grid.body.sums[e, k, i] = wp.int64(0)
    s.fresh[e] = 0
    s.clock[e] = s.clock[e] + h


@wp.func
def middle(e: int, ahead: wp.float64, chain: Chain, s: Motion) -> wp.vec2d:
    """Centre of the links' weights after ``ahead`` seconds at the links' velocities."""
    at = wp.vec2d()
    total = wp.float64(0.0)
    for k in range(chain.length.shape[0]):
        x = s.link[e, k] + ahead * s.twist[e, k]
        at += chain.weight[e, k] * wp.vec2d(x[0], x[1])
        total += chain.weight[e, k]
    return at / total


@wp.func
def measure(e: int, h: wp.float64, chain: Chain, s: Motion) -> None:
    """Angles that the joints' sensors read."""
    for k in range(s.q.shape[1] - 3):
        angle = s.q[e, 3 + k]
        if (chain.active[e, k] & wp.static(wp.int64(SENSOR_BITS))) != wp.int64(0):
            angle = measured_angle(
                angle, angle, s.v[e, 3 + k], s.torque[e, k], s.clock[e], h, chain.servo[e, k],
                chain.memory[e, k], chain.active[e, k],
            )  # fmt: skip
        s.measured[e, k] = angle - chain.trim[e, k]


@wp.kernel(enable_backward=False)
def move(chain: Chain, s: Motion, grid: OnGrid, mode: int, stopped: wp.array(dtype=wp.int32)):
    """Advance the coordinates by one step, after that of the fluid; the head is shifted back."""
    e = wp.tid()
    if stopped[e] >= 0:
        return
    free = mode != wp.static(HELD) and chain.weight[e, 0] > wp.float64(0.0)
    target = wp.vec2d()
    if free:
        target = middle(e, grid.step, chain, s)
    for i in range(s.q.shape[1]):
        s.q[e, i] = s.q[e, i] + grid.step * s.v[e, i]
    pose_links(e, chain, s)
    if free:
        off = target - middle(e, wp.float64(0.0), chain, s)
        s.q[e, 0] = s.q[e, 0] + off[0]
        s.q[e, 1] = s.q[e, 1] + off[1]
        pose_links(e, chain, s)
    measure(e, grid.step, chain, s)
    show(e, chain, s, grid)
