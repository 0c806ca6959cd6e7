"""A link's cross-sections as the grid sees them: how far a point is from its surface."""

import warp as wp

RAMP = 1.0
"""Width in cells over which a cell's solid share falls from 1 to 0."""


@wp.func
def along(profile: wp.vec3, s: float) -> float:
    """The quadratic through values at 0, 1/2 and 1."""
    return (
        profile[0] * (1.0 - s) * (1.0 - 2.0 * s)
        + 4.0 * profile[1] * s * (1.0 - s)
        + profile[2] * s * (2.0 * s - 1.0)
    )


@wp.func
def position_on(x: float, y: float, pose: wp.vec4, length: float) -> wp.vec2:
    """Share of the way along a link's axis, 0 to 1, and distance from the axis.

    ``pose`` is the front end and the cosine and sine of the heading.
    """
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
