"""Warp structs of a batch of chains of links: parameters and state."""

import warp as wp

RING = 16
"""Number of the latest set-points of a joint that are stored."""


@wp.struct
class Chain:
    """Parameters of links, joints and servos of E robots, with their shapes.

    Attributes:
        mass: Mass and inertia of each link minus those of the water inside it, (E, L).
        water: Mass and inertia of that water times the share of the virtual mass, (E, L).
        weight: Weight of each link in the centre that moves straight in a step (``move``), (E, L).
        com: Distance of the centre of mass from the front end, (E, L).
        side: Its distance to the left of the axis, (E, L).
        length: (L,).
        limits: Smallest and largest angle of each joint, (J,).
        servo: Rows of the servo law's parameters, (E, J, columns).
        active: Effects that are on, (E, J).
        memory: Memory of the effects, (E, J, cells).
        push: Outside forces along the coordinates, (E, N).
        rough: Additional friction coefficient of each link's surface, (E, L).
        resist: For each link: drag in N s/m, drag along its axis in N s2/m2, added mass across it
            in kg, added inertia in kg m2, (E, L).
        point: Points of each link's appendages: distance ahead of the centre of mass and to the
            left of it, drag along and across the link in N s2/m2, (E, L, P).
        laden: Added mass of each link's appendages about its centre of mass, in its frame: from
            velocity along, across and of the heading to momentum, (E, L).
        skin: For each joint: stiffness in N m/rad, damping in N m s/rad, relaxing stiffness in
            N m/rad, relaxation time in s, (E, J).
        coupling: Stiffness of the skin between neighbouring joints in N m/rad, (E,).
        tether: Stiffness at the head in N/m, and the anchor's x and y, (E,).
        current: Velocity of the pool's water, which moves the cells, (E,).
        trim: Offset of each joint's angle, (E, J).
        widest: Largest half-width.
    """

    mass: wp.array2d(dtype=wp.vec2d)
    water: wp.array2d(dtype=wp.vec2d)
    weight: wp.array2d(dtype=wp.float64)
    com: wp.array2d(dtype=wp.float64)
    side: wp.array2d(dtype=wp.float64)
    length: wp.array(dtype=wp.float64)
    limits: wp.array(dtype=wp.vec2d)
    servo: wp.array3d(dtype=wp.float64)
    active: wp.array2d(dtype=wp.int64)
    memory: wp.array3d(dtype=wp.float64)
    push: wp.array2d(dtype=wp.float64)
    rough: wp.array2d(dtype=wp.float64)
    resist: wp.array2d(dtype=wp.vec4d)
    point: wp.array3d(dtype=wp.vec4d)
    laden: wp.array2d(dtype=wp.mat33d)
    skin: wp.array2d(dtype=wp.vec4d)
    coupling: wp.array(dtype=wp.float64)
    tether: wp.array(dtype=wp.vec3d)
    current: wp.array(dtype=wp.vec2d)
    trim: wp.array2d(dtype=wp.float64)
    widest: wp.float64


@wp.struct
class Motion:
    """State of E robots with N = 3 + J coordinates and L links.

    Attributes:
        q: Coordinates, (E, N).
        v: Their velocities, (E, N).
        link: Pose of each link's centre of mass: x, y, heading, (E, L).
        joint: Position of each joint, the front end of the link behind it, (E, J).
        twist: Velocity of each link's centre of mass, (E, L).
        before: Its velocity a step earlier, (E, L).
        force: Force and torque of the fluid on each link in the last step, (E, L).
        inner: Momentum of the water inside it, with the moment about the origin, (E, L).
        held: Momentum of the added mass of its appendages in the last step, (E, L).
        fresh: 1 before the first step, when that momentum is not known, (E,).
        torque: Torque of each servo, (E, J).
        impulse, stop: Impulses of dry friction and of the limit at each joint, (E, J).
        strain: Angle to which the skin over each joint has relaxed, (E, J).
        measured: Angle measured by each joint's sensor, (E, J).
        clock: Seconds since the start, (E,).
        sent, arrival: Latest set-points and their times of arrival, (E, J, RING).
        newest: Number of the newest set-point, (E, J).
        A, b, inverse: Memory for the equations, (E, N, N), (E, N) and (E, N, N).
    """

    q: wp.array2d(dtype=wp.float64)
    v: wp.array2d(dtype=wp.float64)
    link: wp.array2d(dtype=wp.vec3d)
    joint: wp.array2d(dtype=wp.vec2d)
    twist: wp.array2d(dtype=wp.vec3d)
    before: wp.array2d(dtype=wp.vec3d)
    force: wp.array2d(dtype=wp.vec3d)
    inner: wp.array2d(dtype=wp.vec3d)
    held: wp.array2d(dtype=wp.vec3d)
    fresh: wp.array(dtype=wp.int32)
    torque: wp.array2d(dtype=wp.float64)
    impulse: wp.array2d(dtype=wp.float64)
    stop: wp.array2d(dtype=wp.float64)
    strain: wp.array2d(dtype=wp.float64)
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
