"""Kinds of cells, and their places in a box."""

import warp as wp

FLUID, SOLID, MOVING, SLIP = range(4)
"""Kinds of cells. A wall lies half-way between a wall cell and the fluid."""
KIND, GHOST, BODY, EDGE = 7, 32, 64, 128
"""Bits of a cell's flag: its kind; a ghost cell; pushed by a body; at the edge of its box, where
cells wrap."""


@wp.struct
class Box:
    """The boxes: cells along each axis, cells of one box, and of all."""

    nx: int
    ny: int
    nz: int
    cells: int
    total: int
    t: int  # parity of the next step
    flags: wp.array(dtype=wp.uint8)  # kind and bits of each cell, (total,)
    stopped: wp.array(dtype=wp.int32)  # cell of supersonic flow that stopped a box, or -1, (E,)


@wp.struct
class Covered:
    """Bodies of L links, in cells, and the cells that they cover, layer by layer in a square."""

    middle: float  # height of the bodies' middle
    length: wp.array(dtype=wp.float32)  # of the links, (L,)
    half_width: wp.array(dtype=wp.vec3)  # of each link at its front, middle and back, (L,)
    half_height: wp.array(dtype=wp.vec3)
    pose: wp.array2d(
        dtype=wp.vec4
    )  # front end of each link, cosine and sine of its heading, (E, L)
    centre: wp.array2d(dtype=wp.vec2)  # its centre of mass, (E, L)
    twist: wp.array2d(dtype=wp.vec4)  # its velocity along x and y and of its heading, (E, L)
    sums: wp.array3d(dtype=wp.int64)  # the fluid's sums over it (``coupling``), (E, L, SUMS)
    kept: wp.array(dtype=wp.float32)  # ``leak`` of all links, a mean over steps, (E,)
    side: int  # cells along a side of the squares
    low: int  # lowest layer
    tall: int  # number of layers
    layers: int  # layers of a column that one thread takes, where threads share columns
    lanes: int  # threads that share the listed cells of a body
    # first cell of each body's square in the plane, and its extent, (E,)
    corner: wp.array(dtype=wp.vec4i)
    # number of the link of a cell plus the cell's solid share, (E side side tall,)
    share: wp.array(dtype=wp.float32)
    # normal of the surface there, 0 where the water does not slip, and the share of the velocity
    # along it (without slip, of all) that the body takes away in a step, (E side side tall,); of
    # ghost cells the density of the water outside in place of that share
    face: wp.array(dtype=wp.vec4)
    # density that the links of a ghost cell lack so that no mass passes, (E side side tall,)
    leak: wp.array(dtype=wp.float32)
    # of ghost cells, the velocity along the surface of the water outside, and the velocity across
    # it that the body had before, (E side side tall,)
    water: wp.array(dtype=wp.vec4)
    # normal of that side; of cells next to a body the surface's area over that of the layer of
    # cells around it, last
    back: wp.array(dtype=wp.vec4)
    # density and velocity likewise at the other side of a thin part
    beyond: wp.array(dtype=wp.vec4)
    # bits of the directions in which a ghost cell has water, at either side
    links: wp.array(dtype=wp.vec2i)
    # number of each body's ghost cells, and of the cells next to it, (2 E,)
    count: wp.array(dtype=wp.int32)
    # these cells, counted in the body's square, (2 E, side side tall)
    listed: wp.array2d(dtype=wp.int32)
    # what the cells next to a body that ghost cells fill have more of relaxation time
    damping: float


@wp.func
def place(n: int, box: Box) -> wp.vec3i:
    """Coordinates of a cell in its box."""
    rest = n % box.cells
    x = rest % box.nx
    rest = rest // box.nx
    return wp.vec3i(x, rest % box.ny, rest // box.ny)


@wp.func
def within(x: int, size: int) -> int:
    """Any coordinate, wrapped into a periodic box."""
    rest = x % size
    if rest < 0:
        rest += size
    return rest


@wp.func
def column_at(e: int, column: int, covered: Covered, box: Box) -> wp.vec3i:
    """Coordinates in the plane of a column of a body's square, and its lowest cell, -1 outside."""
    corner = covered.corner[e]
    dx = column % covered.side
    dy = column // covered.side
    if dx >= corner[2] or dy >= corner[3]:
        return wp.vec3i(0, 0, -1)
    x = corner[0] + dx
    y = corner[1] + dy
    return wp.vec3i(x, y, e * box.cells + within(x, box.nx) + box.nx * within(y, box.ny))


@wp.func
def slot_at(e: int, cell: int, covered: Covered) -> int:
    """Index of a cell of a body's square in the arrays of covered cells."""
    return e * covered.side * covered.side * covered.tall + cell


@wp.func
def rigid_velocity(twist: wp.vec4, r: wp.vec2) -> wp.vec3:
    """Velocity of a rigid body's point at ``r`` from the centre whose velocity ``twist`` has."""
    return wp.vec3(twist[0] - twist[2] * r[1], twist[1] + twist[2] * r[0], 0.0)


@wp.func
def wrapped(x: int, size: int) -> int:
    """A coordinate at most one step outside, wrapped into a periodic box."""
    if x < 0:
        return x + size
    if x >= size:
        return x - size
    return x


@wp.func
def neighbour(n: int, dx: int, dy: int, dz: int, box: Box) -> int:
    """The cell (dx, dy, dz) away, at most one step along each axis."""
    at = place(n, box)
    x = wrapped(at[0] + dx, box.nx)
    y = wrapped(at[1] + dy, box.ny)
    z = wrapped(at[2] + dz, box.nz)
    return n + (x - at[0]) + box.nx * ((y - at[1]) + box.ny * (z - at[2]))
