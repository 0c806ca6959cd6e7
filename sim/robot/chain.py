"""Warp structs of a batch of chains of links: parameters and state."""

import warp as wp

RING = 16
"""Number of the latest set-points of a joint that are stored."""


@wp.struct
class Chain:
    """Parameters of links, joints and servos of E robots, with their shapes."""

    # mass and inertia of each link minus those of the water inside it, (E, L)
    mass: wp.array2d(dtype=wp.vec2d)
    # mass and inertia of that water times the share of the virtual mass, (E, L)
    water: wp.array2d(dtype=wp.vec2d)
    # weight of each link in the centre that moves straight in a step (``move``), (E, L)
    weight: wp.array2d(dtype=wp.float64)
    com: wp.array2d(dtype=wp.float64)  # distance of the centre of mass from the front end, (E, L)
    side: wp.array2d(dtype=wp.float64)  # its distance to the left of the axis, (E, L)
    length: wp.array(dtype=wp.float64)  # (L,)
    limits: wp.array(dtype=wp.vec2d)  # smallest and largest angle of each joint, (J,)
    servo: wp.array3d(dtype=wp.float64)  # rows of the servo law's parameters, (E, J, columns)
    active: wp.array2d(dtype=wp.int64)  # effects that are on, (E, J)
    memory: wp.array3d(dtype=wp.float64)  # memory of the effects, (E, J, cells)
    push: wp.array2d(dtype=wp.float64)  # outside forces along the coordinates, (E, N)
    # additional friction coefficient of each link's surface, (E, L)
    rough: wp.array2d(dtype=wp.float64)
    # for each link: drag in N s/m, drag along its axis in N s2/m2, added mass across it in kg,
    # added inertia in kg m2, (E, L)
    resist: wp.array2d(dtype=wp.vec4d)
    # points of each link's appendages: distance ahead of the centre of mass and to the left of it,
    # drag along and across the link in N s2/m2, (E, L, P)
    point: wp.array3d(dtype=wp.vec4d)
    # added mass of each link's appendages about its centre of mass, in its frame: from velocity
    # along, across and of the heading to momentum, (E, L)
    laden: wp.array2d(dtype=wp.mat33d)
    # for each joint: stiffness in N m/rad, damping in N m s/rad, relaxing stiffness in N m/rad,
    # relaxation time in s, (E, J)
    skin: wp.array2d(dtype=wp.vec4d)
    # stiffness of the skin between neighbouring joints in N m/rad, (E,)
    coupling: wp.array(dtype=wp.float64)
    tether: wp.array(dtype=wp.vec3d)  # stiffness at the head in N/m, and the anchor's x and y, (E,)
    current: wp.array(dtype=wp.vec2d)  # velocity of the pool's water, which moves the cells, (E,)
    trim: wp.array2d(dtype=wp.float64)  # offset of each joint's angle, (E, J)
    widest: wp.float64  # largest half-width


@wp.struct
class Motion:
    """State of E robots with N = 3 + J coordinates and L links."""

    q: wp.array2d(dtype=wp.float64)  # coordinates, (E, N)
    v: wp.array2d(dtype=wp.float64)  # their velocities, (E, N)
    link: wp.array2d(dtype=wp.vec3d)  # pose of each link's centre of mass: x, y, heading, (E, L)
    # position of each joint, the front end of the link behind it, (E, J)
    joint: wp.array2d(dtype=wp.vec2d)
    twist: wp.array2d(dtype=wp.vec3d)  # velocity of each link's centre of mass, (E, L)
    before: wp.array2d(dtype=wp.vec3d)  # its velocity a step earlier, (E, L)
    # force and torque of the fluid on each link in the last step, (E, L)
    force: wp.array2d(dtype=wp.vec3d)
    # momentum of the water inside it, with the moment about the origin, (E, L)
    inner: wp.array2d(dtype=wp.vec3d)
    # momentum of the added mass of its appendages in the last step, (E, L)
    held: wp.array2d(dtype=wp.vec3d)
    # 1 before the first step, when that momentum is not known, (E,)
    fresh: wp.array(dtype=wp.int32)
    torque: wp.array2d(dtype=wp.float64)  # torque of each servo, (E, J)
    # impulse, stop: impulses of dry friction and of the limit at each joint, (E, J)
    impulse: wp.array2d(dtype=wp.float64)
    stop: wp.array2d(dtype=wp.float64)
    # angle to which the skin over each joint has relaxed, (E, J)
    strain: wp.array2d(dtype=wp.float64)
    measured: wp.array2d(dtype=wp.float64)  # angle measured by each joint's sensor, (E, J)
    clock: wp.array(dtype=wp.float64)  # seconds since the start, (E,)
    # sent, arrival: latest set-points and their times of arrival, (E, J, RING)
    sent: wp.array3d(dtype=wp.float64)
    arrival: wp.array3d(dtype=wp.float64)
    newest: wp.array2d(dtype=wp.int32)  # number of the newest set-point, (E, J)
    # A, b, inverse: memory for the equations, (E, N, N), (E, N) and (E, N, N)
    A: wp.array3d(dtype=wp.float64)
    b: wp.array2d(dtype=wp.float64)
    inverse: wp.array3d(dtype=wp.float64)


@wp.struct
class OnGrid:
    """The robots in lattice units, for the fluid, and the fluid's sums over them.

    ``kept`` is the density that the surface of all links lacks so that no mass passes, a mean over
    ``memory`` steps, (E,), see ``ghost_coupling``.
    """

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
    kept: wp.array(dtype=wp.float32)
    memory: wp.float32
    scale: wp.float64
