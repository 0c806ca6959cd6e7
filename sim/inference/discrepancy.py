"""The discrepancy of a calibrated simulator, as shapes of the error in the signals of a swim.

The simulated fluid, wake and force law have errors that persist because a wake does: the speed is
wrong for seconds, an oscillation has a relative error or a delay. Such an error is no effect of the
catalogue but can be mistaken for one. So each shape is a column of the fit, whose size has one part
common to all swims of a robot and one for each swim (Kennedy and O'Hagan, J. R. Stat. Soc. B 63
(2001) 425).
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial.legendre import legvander
from scipy.ndimage import uniform_filter1d

from sim.robot.swimmer import CONTROL_S
from sim2real.arrays import Array

ORDER = 3
"""Largest order of the polynomials in time of the error of the speed."""
_SLOW = 51
"""Samples of the moving average that separates a signal's mean from its oscillation."""
SHARE, LATE_S = 0.1, 0.01
"""Relative error, and delay in s, of the change that an effect makes."""
HEAD = (
    *(f"error.surge_{n}" for n in range(ORDER + 1)), "error.surge_swing", "error.surge_late",
    "error.sway_swing", "error.sway_late", "error.sway_off",
    "error.yaw_swing", "error.yaw_late", "error.yaw_slow", "error.yaw_off", "error.yaw_off_1",
)  # fmt: skip
"""Shapes of the head's signals; sizes are relative, delays in s, or velocities in m/s and rad/s."""
JOINT = ("swing", "late", "off")
"""Shapes of each joint: relative error, delay in s, offset in rad."""


def names(joints: int) -> tuple[str, ...]:
    """Names of all shapes of a robot."""
    return (*HEAD, *(f"error.joint{j}.{shape}" for j in range(joints) for shape in JOINT))


def shapes(signals: Array) -> dict[str, Array]:
    """Shapes of unit size for the signals (T, 3 + J) of a simulated swim, by name.

    They are computed from simulated signals: the noise of recorded ones would seem to explain
    itself.
    """
    T, K = signals.shape
    slow = uniform_filter1d(signals, _SLOW, axis=0, mode="nearest")
    swing = signals - slow
    late = -np.gradient(swing, CONTROL_S, axis=0)
    polynomials = legvander(np.linspace(-1.0, 1.0, T), ORDER).T
    head = [
        *((0, wave * slow[:, 0]) for wave in polynomials), (0, swing[:, 0]), (0, late[:, 0]),
        (1, swing[:, 1]), (1, late[:, 1]), (1, polynomials[0]),
        (2, swing[:, 2]), (2, late[:, 2]), (2, slow[:, 2]), (2, polynomials[0]),
        (2, polynomials[1]),
    ]  # fmt: skip
    joints = [
        (k, shape) for k in range(3, K) for shape in (swing[:, k], late[:, k], polynomials[0])
    ]
    out = {}
    for name, (k, shape) in zip(names(K - 3), (*head, *joints), strict=True):
        out[name] = np.zeros((T, K))
        out[name][:, k] = shape
    return out


def of_changes(joints: int) -> dict[str, float]:
    """Standard deviations of the shapes of error in the change that an effect makes, by name."""
    return {
        n.removeprefix("error."): LATE_S if n.endswith("late") else SHARE
        for n in names(joints)
        if "off" not in n
    }
