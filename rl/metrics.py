"""Metrics of a swim, as in the paper: energy and turning radius; and path length.

Recordings have a row for each control period, the start first: positions (T, E, 2) in m, headings
(T, E) in rad, unwrapped, joint rates (T, E, J) in rad/s. Rows after the end of an episode are NaN
and ignored.
"""

from __future__ import annotations

import numpy as np

from rl.task import POINT
from sim2real.arrays import Array, Mask

REACHED_M = POINT.arrive_m
"""Distance at which a target counts as reached."""
_FROM, _TO = 0.1, 0.9
_FLAT = 1e-9


def energy(rate: Array) -> Array:
    """The paper's measure of energy, the sum over steps of 20 ms of the joints' squared rates.

    It is not mechanical work: its unit is rad^2/s^2; multiplied by 0.02 s it is the integral over
    time. The row of the start is included. ``rate`` has the shape (T, E, J), the result (E,), NaN
    where all rows are NaN.
    """
    finite = _finite(rate)
    total = np.where(finite, np.square(rate).sum(axis=2), 0.0).sum(axis=0)
    return np.where(finite.any(axis=0), total, np.nan)


def path_length(position: Array) -> Array:
    """Length in m of the path through the finite rows of (T, E, 2), shape (E,)."""
    step = np.linalg.norm(np.diff(position, axis=0), axis=2)
    finite = _finite(position).any(axis=0)
    return np.where(finite, np.nansum(step, axis=0), np.nan)


def turning_radius(position: Array, heading: Array, *, turn_rad: float = np.pi) -> Array:
    """Radius of a circle fitted to the middle part of the turn, in m.

    The middle part are the rows from the first at which the heading has changed by a tenth of
    ``turn_rad`` (in either direction) until the first at which it has by nine tenths. The circle is
    the least-squares fit of Kasa (IEEE Trans. Instrum. Meas. 25 (1976) 8) to the path of the head's
    centre of mass.

    Args:
        position: Shape (T, E, 2).
        heading: Shape (T, E), unwrapped.
        turn_rad: Angle of the turn in the task.

    Returns:
        Shape (E,); NaN if the heading changes by less, infinite if the path is straight.
    """
    changed = np.abs(heading - heading[0])
    started, done = (np.asarray(changed >= part * turn_rad) for part in (_FROM, _TO))
    row = np.arange(len(heading))[:, None]
    middle = (row >= started.argmax(axis=0)) & (row <= done.argmax(axis=0)) & done.any(axis=0)
    return circle_radius(np.where(middle[..., None], position, np.nan))


def circle_radius(position: Array) -> Array:
    """Radius of the least-squares circle through the finite rows of (T, E, 2), shape (E,)."""
    finite = _finite(position)
    count = finite.sum(axis=0)
    points = np.where(finite[..., None], position, 0.0)
    middle = points.sum(axis=0) / np.maximum(count, 1)[:, None]
    x, y = np.moveaxis(np.where(finite[..., None], position - middle, 0.0), 2, 0)
    square = x * x + y * y
    xx, xy, yy = (x * x).sum(axis=0), (x * y).sum(axis=0), (y * y).sum(axis=0)
    right, up = (x * square).sum(axis=0) / 2, (y * square).sum(axis=0) / 2
    det = xx * yy - xy * xy
    straight = det <= _FLAT * (xx + yy) ** 2
    safe = np.where(straight, 1.0, det)
    cx, cy = (right * yy - up * xy) / safe, (up * xx - right * xy) / safe
    radius = np.sqrt(cx * cx + cy * cy + (xx + yy) / np.maximum(count, 1))
    return np.where(count < 3, np.nan, np.where(straight, np.inf, radius))


def _finite(rows: Array) -> Mask:
    return np.asarray(np.isfinite(rows).all(axis=2))
