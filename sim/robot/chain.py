"""Warp structs of a batch of chains of links: parameters and state."""

from typing import Any

import numpy as np
import warp as wp

from sim.lattice.cell import Covered

RING = 16
"""Number of the latest set-points of a joint that are stored."""
Reals = wp.array(dtype=wp.float64)
Reals2 = wp.array2d(dtype=wp.float64)
Reals3 = wp.array3d(dtype=wp.float64)
Points2 = wp.array2d(dtype=wp.vec2d)
Planar2 = wp.array2d(dtype=wp.vec3d)


@wp.struct
class Chain:
    """Parameters of links, joints and servos of E robots, with their shapes."""

    mass: Points2  # mass and inertia of each link minus those of the water inside it, (E, L)
    water: Points2  # mass and inertia of that water times the share of the virtual mass, (E, L)
    weight: Reals2  # weight of each link in the centre that moves straight in a step, (E, L)
    com: Reals2  # distance of the centre of mass from the front end, (E, L)
    side: Reals2  # its distance to the left of the axis, (E, L)
    length: Reals  # (L,)
    limits: wp.array(dtype=wp.vec2d)  # smallest and largest angle of each joint, (J,)
    servo: Reals3  # rows of the servo law's parameters, (E, J, columns)
    active: wp.array2d(dtype=wp.int64)  # effects that are on, (E, J)
    memory: Reals3  # memory of the effects, (E, J, cells)
    push: Reals2  # outside forces along the coordinates, (E, N)
    rough: Reals2  # additional friction coefficient of each link's surface, (E, L)
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
    coupling: Reals  # stiffness of the skin between neighbouring joints in N m/rad, (E,)
    tether: wp.array(dtype=wp.vec3d)  # stiffness at the head in N/m, and the anchor's x and y, (E,)
    current: wp.array(dtype=wp.vec2d)  # velocity of the pool's water, which moves the cells, (E,)
    trim: Reals2  # offset of each joint's angle, (E, J)
    widest: wp.float64  # largest half-width


@wp.struct
class Motion:
    """State of E robots with N = 3 + J coordinates and L links."""

    q: Reals2  # coordinates, (E, N)
    v: Reals2  # their velocities, (E, N)
    link: Planar2  # pose of each link's centre of mass: x, y, heading, (E, L)
    joint: Points2  # position of each joint, the front end of the link behind it, (E, J)
    twist: Planar2  # velocity of each link's centre of mass, (E, L)
    before: Planar2  # its velocity a step earlier, (E, L)
    force: Planar2  # force and torque of the fluid on each link in the last step, (E, L)
    inner: Planar2  # momentum of the water inside it, with the moment about the origin, (E, L)
    held: Planar2  # momentum of the added mass of its appendages in the last step, (E, L)
    fresh: wp.array(dtype=wp.int32)  # 1 before the first step, when that is not known, (E,)
    torque: Reals2  # torque of each servo, (E, J)
    impulse: Reals2  # impulse of dry friction at each joint, (E, J)
    stop: Reals2  # impulse of its limit, (E, J)
    strain: Reals2  # angle to which the skin over each joint has relaxed, (E, J)
    measured: Reals2  # angle measured by each joint's sensor, (E, J)
    clock: Reals  # seconds since the start, (E,)
    sent: Reals3  # latest set-points, (E, J, RING)
    arrival: Reals3  # their times of arrival, (E, J, RING)
    newest: wp.array2d(dtype=wp.int32)  # number of the newest set-point, (E, J)
    A: Reals3  # memory for the equations, (E, N, N)
    b: Reals2  # likewise, (E, N)
    inverse: Reals3  # likewise, (E, N, N)


@wp.struct
class OnGrid:
    """The robots in lattice units, for the fluid, and the fluid's sums over them."""

    cell: wp.float64
    step: wp.float64
    mass: wp.float64
    origin: wp.vec2d
    margin: int
    position: wp.array(dtype=wp.vec2)
    body: Covered
    memory: wp.float32  # steps of the mean ``body.kept``
    scale: wp.float64


def fill(struct: Any, device: Any, **values: Any) -> Any:  # noqa: ANN401 - Warp has no stubs
    """Set arrays of a Warp struct, of values, or of zeros where a value is a shape; return it."""
    for name, value in values.items():
        kind = struct._cls.vars[name].type.dtype
        if isinstance(value, tuple):
            array: Any = wp.zeros(value, dtype=kind, device=device)
        else:
            array = wp.array(np.ascontiguousarray(value), dtype=kind, device=device)
        setattr(struct, name, array)
    return struct


def still(E: int, L: int, device: Any) -> Any:  # noqa: ANN401
    """The state of E robots with L links on a device, all 0 and without set-points."""
    links, joints, N = (E, L), (E, L - 1), L + 2
    s = fill(
        Motion(), device, q=(E, N), v=(E, N), b=(E, N), A=(E, N, N), inverse=(E, N, N),
        link=links, twist=links, before=links, force=links, inner=links, held=links,
        joint=joints, torque=joints, impulse=joints, stop=joints, strain=joints, measured=joints,
        sent=(*joints, RING), arrival=(*joints, RING), newest=joints, fresh=(E,), clock=(E,),
    )  # fmt: skip
    s.newest.fill_(-1)
    return s
