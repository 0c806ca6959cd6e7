"""What the motion of a batch of chains of links is made of, in memory."""

import warp as wp

RING = 16
"""Set-points on their way to a joint that are remembered."""


@wp.struct
class Chain:
    """Links, joints and servos of E robots; row by row in the shape that is given.

    Attributes:
        mass: Mass and inertia of each link less those of the water inside it, (E, L).
        water: Mass and inertia of that water times the share that is virtual, (E, L).
        weight: Of each link in the centre that goes straight on in a step (``move``), (E, L).
        com: Distance of the centre of mass from the front end, (E, L).
        side: Its distance to the left of the axis, (E, L).
        length: (L,).
        limits: Smallest and largest angle of each joint, (J,).
        servo: Rows of the servo law's parameters, (E, J, columns).
        active: Effects that are on, (E, J).
        memory: Memory of the effects, (E, J, cells).
        push: Outside forces along the coordinates, (E, N).
        rough: Added friction coefficient of each link's surface, (E, L).
        resist: Of each link: drag in N s/m, drag along its axis in N s2/m2, mass across it in
            kg, inertia in kg m2, (E, L).
        skin: Over each joint: N m/rad, N m s/rad, N m/rad that relax, their time in s, (E, J).
        coupling: N m/rad of the skin between neighbouring joints, (E,).
        tether: N/m on the head, and the anchor's x and y, (E,).
        current: Velocity of the pool against the cells, (E,).
        trim: Angle by which each joint is off, (E, J).
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
        twist: Its velocity, (E, L).
        before: Its velocity a step earlier, (E, L).
        force: Force and torque of the fluid on each link in the last step, (E, L).
        inner: Momentum of the water inside it, the moment about the origin, (E, L).
        fresh: 1 before the first step, when that momentum is not known, (E,).
        torque: Torque of each servo, (E, J).
        impulse, stop: Impulses of dry friction and of the limit at each joint, (E, J).
        strain: Angle to which the skin over each joint has relaxed, (E, J).
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
    inner: wp.array2d(dtype=wp.vec3d)
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
    """The robots as the fluid sees them, in lattice units, and its sums over them.

    ``kept`` is the velocity along each link's axis that the cells beside it get back in a step
    (``coupling``), a mean over ``memory`` steps, (E, L).
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
    kept: wp.array2d(dtype=wp.float32)
    memory: wp.float32
    scale: wp.float64
