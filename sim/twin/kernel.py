"""The kernels of the reduced-order twin: a chain of links in water described by a force law.

Each link has added mass across and along its axis. Water that leaves the tail's end carries its
momentum away (Lighthill, Proc. R. Soc. B 179 (1971) 125): with added mass m per length and
velocities w across and u along the tail, the force is - m w u across it and + m w w / 2 along it.
Drag is that of Morison et al. (1950) plus a linear term, implicit, relative to the wake: the water
around a link approaches a share of the link's velocity V, d moved / dt = (share V - moved) / T. The
quadratic drag across, C |w| w, grows with its vortices: it is C |w| late, where late follows w over
a distance, as lift does after a start (Wagner, Z. Angew. Math. Mech. 5 (1925) 17).
"""

import warp as wp

from sim.robot.chain import Chain, Motion, Planar2, Points2, Reals, Reals2, Reals3
from sim.robot.joints import send_to
from sim.robot.multibody import begin, column, measure, middle, move_links, pose_links, solve_free
from sim.robot.outside import appendages, held, hold, pull, resist
from sim.twin import law as twin_law
from sim2real.effects import SIGNATURE

POINTS = wp.constant(twin_law.POINTS)


@wp.struct
class Water:
    """Coefficients and state of the force law, with their shapes."""

    place: Reals3  # distance of each point ahead of the link's centre of mass in m, (E, L, POINTS)
    added: Reals3  # added mass across the link at each point in kg, (E, L, POINTS)
    broad: Reals3  # quadratic drag across the link at each point in N s2/m2, (E, L, POINTS)
    reach: Reals3  # distance in m over which that drag grows at each point, (E, L, POINTS)
    slow: Reals3  # linear drag across the link at each point in N s/m, (E, L, POINTS)
    along: Points2  # linear and quadratic drag along each link in N s/m and N s2/m2, (E, L)
    axial: Reals2  # added mass of each link along its axis in kg, (E, L)
    # added mass per length at the tail's end in kg/m, and distance in m of this end behind the last
    # link's centre of mass, (E,)
    tip: wp.array(dtype=wp.vec2d)
    # share of a link's velocity that the water around it approaches, and the time constant in s,
    # (E,)
    wake: wp.array(dtype=wp.vec2d)
    wall: Reals  # relative increase of the thrust by a wall one body length away, (E,)
    pool: wp.vec3d  # half the pool's length and width in m, and the body's length
    carried: Planar2  # momentum and angular momentum of the added mass in the last step, (E, L)
    moved: Points2  # velocity of the water around each link in m/s, in the world frame, (E, L)
    late: Reals3  # delayed velocity across each point in m/s, for that drag, (E, L, POINTS)


@wp.func
def impulse(e: int, k: int, chain: Chain, s: Motion, water: Water) -> wp.vec3d:
    """Momentum and angular momentum of the added mass of link k at its velocity."""
    at = s.link[e, k]
    V = s.twist[e, k]
    c = wp.cos(at[2])
    d = wp.sin(at[2])
    across = c * V[1] - d * V[0]
    p = wp.float64(0.0)
    spin = wp.float64(0.0)
    for j in range(POINTS):
        r = water.place[e, k, j]
        m = water.added[e, k, j] * (across + V[2] * r)
        p += m
        spin += m * r
    along = water.axial[e, k] * (c * V[0] + d * V[1])
    return wp.vec3d(along * c - p * d, along * d + p * c, spin)


@wp.func
def stir(e: int, k: int, h: wp.float64, s: Motion, water: Water) -> int:
    """Update the velocity of the wake around link k."""
    wake = water.wake[e]
    if wake[0] != wp.float64(0.0):
        V = s.twist[e, k]
        moved = water.moved[e, k]
        kept = wp.exp(-h / wake[1])
        water.moved[e, k] = kept * moved + (wp.float64(1.0) - kept) * wake[0] * wp.vec2d(V[0], V[1])
    return 0


@wp.func
def tail_end(e: int, ahead: wp.float64, w: wp.float64, s: Motion, water: Water) -> wp.vec2d:
    """Lighthill's force at the tail's end, along and across it, with the effect of a wall."""
    mass = water.tip[e][0]
    if water.wall[e] != wp.float64(0.0):
        at = s.link[e, s.link.shape[1] - 1]
        gap = wp.min(water.pool[0] - wp.abs(at[0]), water.pool[1] - wp.abs(at[1]))
        share = water.pool[2] / wp.max(gap, wp.float64(0.5) * water.pool[2])
        mass = mass * (wp.float64(1.0) + water.wall[e] * share * share)
    return wp.vec2d(wp.float64(0.5) * mass * w * w, -mass * w * ahead)


@wp.func
def advance_twin(
    e: int, h: wp.float64, chain: Chain, s: Motion, water: Water, friction: Reals2
) -> int:
    """One sub-step of robot e."""
    zero = wp.float64(0.0)
    L = chain.length.shape[0]
    N = 2 + L
    begin(e, h, chain, s)
    for k in range(L):
        at = s.link[e, k]
        V = s.twist[e, k]
        c = wp.cos(at[2])
        d = wp.sin(at[2])
        ahead = c * V[0] + d * V[1]
        across = c * V[1] - d * V[0]
        moved = water.moved[e, k]
        flow_t = c * moved[0] + d * moved[1]
        flow_n = c * moved[1] - d * moved[0]
        a0 = zero
        a1 = zero
        a2 = zero
        push_n = zero
        turn = zero
        for j in range(POINTS):
            r = water.place[e, k, j]
            w = across + V[2] * r - flow_n
            broad = h * water.broad[e, k, j] * wp.abs(w)
            drag = h * water.slow[e, k, j] + broad
            inertia = water.added[e, k, j] + drag
            push_back = drag * flow_n
            if water.reach[e, k, j] > zero:
                distance = h * wp.sqrt(w * w + (ahead - flow_t) * (ahead - flow_t))
                lag = (w - water.late[e, k, j]) * wp.exp(-distance / water.reach[e, k, j])
                push_back += broad * lag
                water.late[e, k, j] = w - lag
            push_n += push_back
            turn += push_back * r
            a0 += inertia
            a1 += inertia * r
            a2 += inertia * r * r
        rough = water.along[e, k]
        drag = h * (rough[0] + rough[1] * wp.abs(ahead - flow_t))
        along = water.axial[e, k] + drag
        push_t = drag * flow_t
        m = chain.mass[e, k]
        before = water.carried[e, k]
        turn += h * (
            across * (before[0] * c + before[1] * d) - ahead * (before[1] * c - before[0] * d)
        )
        R = wp.vec3d(m[0] * V[0] + before[0], m[0] * V[1] + before[1], m[1] * V[2] + before[2])
        R += held(e, k, h, s)
        laden = appendages(e, k, h, chain, s) + resist(e, k, h, chain, s)
        tether = zero
        if k == 0:
            R += pull(e, h, chain, s)
            tether = h * h * chain.tether[e][0]
        if k == L - 1:
            arm = water.tip[e][1]
            end = tail_end(e, ahead, across - V[2] * arm, s, water)
            push_t += h * end[0]
            push_n += h * end[1]
            turn -= h * arm * end[1]
        R += wp.vec3d(push_t * c - push_n * d, push_t * d + push_n * c, turn)
        for i in range(3 + k):
            a = column(e, k, i, s)
            s.b[e, i] = s.b[e, i] + wp.dot(a, R)
            at_n = c * a[1] - d * a[0]
            f_n = a0 * at_n + a1 * a[2]
            f_t = along * (c * a[0] + d * a[1])
            Ka = wp.vec3d(
                (m[0] + tether) * a[0] + f_t * c - f_n * d,
                (m[0] + tether) * a[1] + f_t * d + f_n * c,
                m[1] * a[2] + a1 * at_n + a2 * a[2],
            )
            Ka += laden * a
            for j in range(i + 1):
                s.A[e, i, j] = s.A[e, i, j] + wp.dot(Ka, column(e, k, j, s))
    solve_free(e, h, chain, s, friction)
    for i in range(N):
        s.v[e, i] = s.b[e, i]
    move_links(e, s)
    for k in range(L):
        water.carried[e, k] = impulse(e, k, chain, s, water)
        hold(e, k, chain, s)
        stir(e, k, h, s, water)
    s.clock[e] = s.clock[e] + h
    return 0


@wp.func
def move_twin(e: int, h: wp.float64, chain: Chain, s: Motion) -> int:
    """Advance the coordinates, so that the centre of mass moves with its velocity."""
    target = middle(e, h, chain, s)
    for i in range(s.q.shape[1]):
        s.q[e, i] = s.q[e, i] + h * s.v[e, i]
    pose_links(e, chain, s)
    off = target - middle(e, wp.float64(0.0), chain, s)
    s.q[e, 0] = s.q[e, 0] + off[0]
    s.q[e, 1] = s.q[e, 1] + off[1]
    for k in range(chain.length.shape[0]):
        at = s.link[e, k]
        s.link[e, k] = wp.vec3d(at[0] + off[0], at[1] + off[1], at[2])
        if k > 0:
            s.joint[e, k - 1] = s.joint[e, k - 1] + off
    measure(e, h, chain, s)
    return 0


@wp.kernel(enable_backward=False)
def start_twin(chain: Chain, s: Motion, water: Water, mask: wp.array(dtype=wp.int32)):
    """Compute the links' poses and velocities from the coordinates, where ``mask`` is set."""
    e = wp.tid()
    if mask[e] == 0:
        return
    pose_links(e, chain, s)
    move_links(e, s)
    for k in range(chain.length.shape[0]):
        water.carried[e, k] = impulse(e, k, chain, s, water)
        hold(e, k, chain, s)


@wp.kernel(enable_backward=False)
def swim_twin(
    first: int,
    command: Reals3,
    which: wp.array(dtype=wp.int32),
    count: int,
    substeps: int,
    h: wp.float64,
    chain: Chain,
    s: Motion,
    water: Water,
    friction: Reals2,
    track: Reals3,
):
    """Simulate periods of robot e; ``track`` gets x, y, heading and measured angles of each."""
    _ = wp.static(SIGNATURE)
    e = first + wp.tid()
    J = s.newest.shape[1]
    for n in range(count):
        for k in range(J):
            send_to(e, k, command[which[e], n, k], chain, s)
        for _i in range(substeps):
            advance_twin(e, h, chain, s, water, friction)
            move_twin(e, h, chain, s)
        if n < track.shape[1]:
            for i in range(3):
                track[e, n, i] = s.q[e, i]
            for k in range(J):
                track[e, n, 3 + k] = s.measured[e, k]
