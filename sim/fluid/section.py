"""A link's cross-sections on the grid: distance of a point from its surface."""

import warp as wp

from sim.lattice.cell import Covered

RAMP = 1.0
"""Width in cells over which a cell's solid share falls from 1 to 0."""
SHEET = 1.5
"""For ghost cells, in cells: half-thickness below which a tall part is a sheet."""
TIP = 1.0
"""For ghost cells, in cells: at a round end, sections with a smaller radius that are nearer to the
end than this are not covered. Whether they contain the centre of a cell depends on the position on
the grid: with them a spheroid four cells thick has a drag coefficient of -0.0004 to 0.0225, without
them -0.003 to 0.001; it is 0 in ideal fluid (``benchmarks.validation``)."""


@wp.func
def along(profile: wp.vec3, s: float) -> float:
    """The quadratic through values at 0, 1/2 and 1."""
    return (
        profile[0] * (1.0 - s) * (1.0 - 2.0 * s)
        + 4.0 * profile[1] * s * (1.0 - s)
        + profile[2] * s * (2.0 * s - 1.0)
    )


@wp.func
def taper(profile: wp.vec3, s: float) -> float:
    """Derivative of that quadratic."""
    return (
        profile[0] * (4.0 * s - 3.0)
        + 4.0 * profile[1] * (1.0 - 2.0 * s)
        + profile[2] * (4.0 * s - 1.0)
    )


@wp.func
def position_on(x: float, y: float, pose: wp.vec4, length: float) -> wp.vec2:
    """Share of the way along a link's axis and distance from it; ``pose``: front end, cos, sin."""
    dx = x - pose[0]
    dy = y - pose[1]
    back = wp.clamp(-(dx * pose[2] + dy * pose[3]), 0.0, length)
    dx += back * pose[2]
    dy += back * pose[3]
    share = float(0.0)
    if length > 0.0:
        share = back / length
    return wp.vec2(share, wp.sqrt(dx * dx + dy * dy))


@wp.func
def distance(off_axis: float, z: float, half_width: float, half_height: float) -> float:
    """Signed distance from a section's ellipse, to first order near it; negative inside."""
    if z == 0.0:
        return off_axis - half_width
    ratio = half_width / half_height
    stretched = wp.sqrt(off_axis * off_axis + z * z * ratio * ratio)
    if stretched < 1.0e-6:
        return -half_width
    slope = wp.sqrt(off_axis * off_axis + z * z * ratio * ratio * ratio * ratio) / stretched
    return (stretched - half_width) / slope


@wp.func
def solid_share(signed_distance: float) -> float:
    """Share of a cell that is solid."""
    return wp.clamp(0.5 - signed_distance / wp.static(RAMP), 0.0, 1.0)


@wp.func
def sealed(n: wp.vec3) -> float:
    """Half-thickness of a sheet with this normal through which no link of the lattice passes."""
    x = wp.abs(n[0])
    y = wp.abs(n[1])
    z = wp.abs(n[2])
    return 0.5 * (x + y + z - wp.min(x, wp.min(y, z))) + 0.01


@wp.func
def dither(x: float, y: float) -> float:
    """From -1/2 to 1/2, evenly spread over the columns of cells (R2 sequence, Roberts 2018)."""
    turns = 0.7548777 * x + 0.5698403 * y
    return turns - wp.floor(turns) - 0.5


@wp.func
def surface(
    x: float, y: float, z: float, e: int, link: int, covered: Covered, rest: wp.vec2, edge: float
):
    """Signed distance from a link's surface, its normal, and depth of a thin part's other side.

    ``rest`` is the length of the chain in front of and behind the link, ``edge`` the distance by
    which the edges of a sheet are moved inwards. Sections are ellipses. Parts thinner than
    ``SHEET`` are a sheet with the normals of its two sides, which the water leaves along the sides;
    it ends where the chain ends, and is closed at the joints. Its upper and lower edges lie between
    two layers of cells: ``dither`` rounds each column up or down. Round ends of the chain stop at
    ``TIP``. The depth is 0 where the link is thick.
    """
    pose = covered.pose[e, link]
    length = covered.length[link]
    width = covered.half_width[link]
    height = covered.half_height[link]
    dx = x - pose[0]
    dy = y - pose[1]
    back = -(dx * pose[2] + dy * pose[3])
    lateral = dy * pose[2] - dx * pose[3]
    clamped = wp.clamp(back, 0.0, length)
    s = float(0.0)
    if length > 0.0:
        s = clamped / length
    w = along(width, s)
    h = along(height, s)
    blunt = wp.clamp(w - wp.static(SHEET) + 2.0 * wp.clamp(1.5 - (h - w), 0.0, 1.0), 0.0, 1.0)
    over = back - clamped
    off = wp.sqrt(lateral * lateral + blunt * over * over)
    low = wp.max(h - 0.5, 0.0)
    up = blunt * z + (1.0 - blunt) * wp.clamp(z, -low, low)
    root = wp.sqrt(wp.max(1.0 - up * up / (h * h), 0.0))
    out = wp.max(wp.max(off, (1.0 - blunt) * w * root), 1.0e-3)
    ahead = float(0.0)
    sideways = float(1.0)
    if lateral < 0.0:
        sideways = -1.0
    if off > 1.0e-4:
        ahead = -blunt * over / off
        sideways = lateral / off
    thick = w * wp.sqrt(wp.max(1.0 - z * z / (h * h), 0.0))
    parallel = blunt < 1.0 and thick < sealed(wp.vec3(pose[3], pose[2], 0.0))
    if over == 0.0 and length > 0.0 and not parallel:
        narrows = out * taper(width, s) / w + up * up * w * w * taper(height, s) / (h * h * h * out)
        ahead += narrows / length
    n = wp.normalize(
        wp.vec3(
            ahead * pose[2] - sideways * pose[3],
            ahead * pose[3] + sideways * pose[2],
            w * w * up / (h * h * out),
        )
    )
    d = distance(off, z, w, h)
    radius = wp.sqrt(wp.max(w * w - over * over, 0.0))
    from_end = w + wp.min(back + rest[0], length + rest[1] - back)
    if h < 2.0 * w and radius < wp.static(TIP) and from_end < wp.static(TIP):
        d = wp.max(d, wp.static(TIP) - radius)
    other = float(0.0)
    if blunt < 1.0:
        half = wp.max(thick, sealed(n))
        d = off - half
        over_end = wp.max(back - length - rest[1], -back - rest[0]) - w
        beyond = wp.max(wp.abs(z) - h + dither(x, y), over_end) + edge
        if beyond > 0.0:
            d = wp.max(d, beyond)
        other = off + half
    return d, n, other
