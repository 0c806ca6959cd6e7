"""What a calibrated simulator still gets wrong of a swim, as shapes in its signals.

A robot's water, its wake and its law are never quite those that are simulated, and a wake remembers
what was before: the speed is wrong for seconds at a time, a swing by a share of itself or by a
moment. Such an error is no effect of the catalogue, but one that any of them may be taken for. So
each shape is a column of a fit with a size of its own, that of all swims of a robot and that of
one (Kennedy and O'Hagan, J. R. Stat. Soc. B 63 (2001) 425).
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from sim.robot.swimmer import CONTROL_S

Array = NDArray[np.float64]

ORDER = 3
"""Of the polynomials along a swim by which its speed is wrong."""
_SLOW = 51
"""Samples over which a signal is averaged, to tell how it swings from where it is."""
SHARE, LATE_S = 0.1, 0.01
"""By which a change that an effect makes is wrong, of itself and in time."""
HEAD = (
    *(f"error.surge_{n}" for n in range(ORDER + 1)), "error.surge_swing", "error.surge_late",
    "error.sway_swing", "error.sway_late", "error.sway_off",
    "error.yaw_swing", "error.yaw_late", "error.yaw_slow", "error.yaw_off", "error.yaw_off_1",
)  # fmt: skip
"""Shares of what the head does, moments in s, and velocities in m/s and rad/s."""
JOINT = ("swing", "late", "off")
"""Of each joint: a share, a moment in s, an angle in rad."""


def names(joints: int) -> tuple[str, ...]:
    """Of all shapes of a robot."""
    return (*HEAD, *(f"error.joint{j}.{shape}" for j in range(joints) for shape in JOINT))


def shapes(signals: Array) -> dict[str, Array]:
    """What a size of one of each adds to the signals (T, 3 + J) of a simulated swim, by name.

    Of a simulated one: in a recorded one there is noise that would seem to explain itself.
    """
    T, K = signals.shape
    slow = uniform_filter1d(signals, _SLOW, axis=0, mode="nearest")
    swing = signals - slow
    late = -np.gradient(swing, CONTROL_S, axis=0)
    along = legvander(np.linspace(-1.0, 1.0, T), ORDER).T
    head = [
        *((0, wave * slow[:, 0]) for wave in along), (0, swing[:, 0]), (0, late[:, 0]),
        (1, swing[:, 1]), (1, late[:, 1]), (1, along[0]),
        (2, swing[:, 2]), (2, late[:, 2]), (2, slow[:, 2]), (2, along[0]), (2, along[1]),
    ]  # fmt: skip
    joints = [(k, one) for k in range(3, K) for one in (swing[:, k], late[:, k], along[0])]
    out = {}
    for name, (k, one) in zip(names(K - 3), (*head, *joints), strict=True):
        out[name] = np.zeros((T, K))
        out[name][:, k] = one
    return out


def of_changes(joints: int) -> dict[str, float]:
    """Shapes by which a change that an effect makes may be wrong, and how large, by name."""
    return {
        n.removeprefix("error."): LATE_S if n.endswith("late") else SHARE
        for n in names(joints)
        if "off" not in n
    }


__all__ = ["SHARE", "names", "of_changes", "shapes"]
