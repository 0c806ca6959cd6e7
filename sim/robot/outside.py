"""Further forces on a robot: its appendages, a skin over its joints, more drag and mass, a tether.

The body's effects of the catalogue set their parameters, for the fluid and the twin alike; each
force is 0 where its parameters are. Appendages move through undisturbed water.
"""

import warp as wp

from sim.robot.chain import Chain, Motion


@wp.func
def resist(e: int, k: int, h: wp.float64, chain: Chain, s: Motion) -> wp.mat33d:
    """Implicit impulse of drag, along also quadratic, and added mass by the velocity of link k."""
    p = chain.resist[e, k]
    heading = s.link[e, k][2]
    c = wp.cos(heading)
    d = wp.sin(heading)
    zero = wp.float64(0.0)
    V = s.twist[e, k]
    along = h * (p[0] + p[1] * wp.abs(c * V[0] + d * V[1]))
    across = h * p[0] + p[2]
    xy = (along - across) * c * d
    return wp.mat33d(
        along * c * c + across * d * d, xy, zero,
        xy, along * d * d + across * c * c, zero,
        zero, zero, p[3],
    )  # fmt: skip


@wp.func
def carried(e: int, k: int, chain: Chain, s: Motion) -> wp.vec3d:
    """Momentum across the link and angular momentum of its added mass."""
    at = s.link[e, k]
    heading = at[2]
    c = wp.cos(heading)
    d = wp.sin(heading)
    normal = wp.vec3d(-d, c, wp.float64(0.0))
    p = chain.resist[e, k]
    V = s.twist[e, k]
    zero = wp.float64(0.0)
    return p[2] * wp.dot(V, normal) * normal + wp.vec3d(zero, zero, p[3] * V[2])


@wp.func
def turned(at: wp.vec3d) -> wp.mat33d:
    """Rotation from a link's frame to the world's, of velocities and momenta."""
    zero = wp.float64(0.0)
    c = wp.cos(at[2])
    d = wp.sin(at[2])
    return wp.mat33d(c, -d, zero, d, c, zero, zero, zero, wp.float64(1.0))


@wp.func
def appendages(e: int, k: int, h: wp.float64, chain: Chain, s: Motion) -> wp.mat33d:
    """Implicit impulse of the appendages of link k by its velocity: added mass, and drag.

    The drag of a point that moves with velocity (u, w) along and across the link is
    - speed (a u, b w): the vector form of Morison's equation, with a coefficient in each direction.
    """
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    inside = chain.laden[e, k]
    some = inside[2, 2] != zero
    for i in range(chain.point.shape[2]):
        some = some or chain.point[e, k, i][2] != zero or chain.point[e, k, i][3] != zero
    if not some:
        return inside
    R = turned(s.link[e, k])
    V = wp.transpose(R) * s.twist[e, k]
    for i in range(chain.point.shape[2]):
        p = chain.point[e, k, i]
        if p[2] != zero or p[3] != zero:
            along = wp.vec3d(one, zero, -p[1])
            across = wp.vec3d(zero, one, p[0])
            u = wp.dot(along, V)
            w = wp.dot(across, V)
            speed = h * wp.sqrt(u * u + w * w)
            inside += speed * p[2] * wp.outer(along, along)
            inside += speed * p[3] * wp.outer(across, across)
    return R * inside * wp.transpose(R)


@wp.func
def hold(e: int, k: int, chain: Chain, s: Motion) -> int:
    """Store the momentum of the added mass of link k's appendages, before it moves."""
    laden = chain.laden[e, k]
    if laden[2, 2] == wp.float64(0.0):
        s.held[e, k] = wp.vec3d()
        return 0
    R = turned(s.link[e, k])
    s.held[e, k] = R * (laden * (wp.transpose(R) * s.twist[e, k]))
    return 0


@wp.func
def held(e: int, k: int, h: wp.float64, s: Motion) -> wp.vec3d:
    """That momentum about the centre of mass of link k, which has moved meanwhile."""
    P = s.held[e, k]
    V = s.twist[e, k]
    return wp.vec3d(P[0], P[1], P[2] - h * (V[0] * P[1] - V[1] * P[0]))


@wp.func
def pull(e: int, h: wp.float64, chain: Chain, s: Motion) -> wp.vec3d:
    """Explicit part of the tether's impulse on the head over a step."""
    p = chain.tether[e]
    at = s.link[e, 0]
    x = p[1] - chain.current[e][0] * s.clock[e] - at[0]
    y = p[2] - chain.current[e][1] * s.clock[e] - at[1]
    return wp.vec3d(h * p[0] * x, h * p[0] * y, wp.float64(0.0))


@wp.func
def skin(e: int, k: int, h: wp.float64, chain: Chain, s: Motion) -> wp.vec2d:
    """Impulse of the skin over joint k, and the equivalent inertia of its implicit part.

    A spring and a damper in parallel with a spring that relaxes (a standard linear solid), and a
    spring to the neighbours' angles.
    """
    p = chain.skin[e, k]
    q = s.q[e, 3 + k]
    v = s.v[e, 3 + k]
    decay = wp.float64(1.0)
    if p[3] > wp.float64(0.0):
        decay = wp.exp(-h / p[3])
    strain = (q - s.strain[e, k]) * decay
    s.strain[e, k] = q - strain
    across = wp.float64(0.0)
    J = s.q.shape[1] - 3
    if k > 0:
        across += s.q[e, 2 + k] - q
    if k < J - 1:
        across += s.q[e, 4 + k] - q
    torque = chain.coupling[e] * across - p[0] * q - p[2] * strain
    gain = wp.float64(0.5) * h * (p[1] + h * (p[0] + p[2]))
    return wp.vec2d(h * (torque - wp.float64(0.5) * (p[1] + h * (p[0] + p[2])) * v), gain)
