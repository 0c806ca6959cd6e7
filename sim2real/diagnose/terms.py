"""The terms of which a formula for a missing torque may be made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

WAVES_PER_RAD = (2, 3, 4, 6, 8, 12, 16)
"""``k`` of sin(k position): from a lever's to a gear tooth's."""
SMALL_SPEED = 0.05
"""Speed in rad/s below which its sign is not known for the noise of the sensor."""


@dataclass(frozen=True)
class State:
    """One joint of one recording as it moved.

    Attributes:
        t: Time since the start in s, shape (T,).
        position: Angle in rad, measured and smoothed or simulated, shape (T,).
        speed: Its derivative in rad/s, shape (T,).
        load: Torque that the proportional gain asks for, N m (or per kg m2), shape (T,).
        others: Measured angles of other joints in rad by name, smoothed, shape (T,) each.
    """

    t: Array
    position: Array
    speed: Array
    load: Array
    others: Mapping[str, Array]


@dataclass(frozen=True)
class Term:
    """A torque up to its factor.

    Attributes:
        words: ``"sgn(speed)"``.
        unit: What the unit of a torque is followed by in that of the factor, ``"/rad³"``; None
            where the factor has none.
        value: Moment by moment, shape (T,).
    """

    words: str
    unit: str | None
    value: Array


def terms(state: State) -> list[Term]:
    """All of them, in the same order for every recording.

    Speed alone and distance from the command are not among them: they are the servo's own gains.
    Neither is acceleration: with them it would be the servo's whole equation, true of any motion.
    """
    q, v, t = state.position, state.speed, state.t
    sign = np.tanh(v / SMALL_SPEED)
    listed = [
        Term("1", "", np.ones_like(q)),
        Term("position", "/rad", q),
        Term("position²", "/rad²", q**2),
        Term("position³", "/rad³", q**3),
        Term("sgn(speed)", "", sign),
        Term("|speed| speed", " s²/rad²", np.abs(v) * v),
        Term("speed³", " s³/rad³", v**3),
        Term("position · speed", " s/rad²", q * v),
        Term("position² · speed", " s/rad³", q**2 * v),
        Term("|position| sgn(speed)", "/rad", np.abs(q) * sign),
        Term("position · speed²", " s²/rad³", q * v**2),
        Term("|load| sgn(speed)", None, np.abs(state.load) * sign),
        Term("|load|", None, np.abs(state.load)),
        Term("time", "/s", t),
        Term("time · position", "/(rad s)", t * q),
        Term("time · speed", "/rad", t * v),
        Term("time · sgn(speed)", "/s", t * sign),
        Term("time · load", None, t * state.load),
    ]
    for k in WAVES_PER_RAD:
        listed += [
            Term(f"sin({k} position)", "", np.sin(k * q)),
            Term(f"cos({k} position)", "", np.cos(k * q)),
        ]
    for name, angle in state.others.items():
        moving = np.gradient(angle, t)
        listed += [
            Term(f"speed of {name}", " s/rad", moving),
            Term(f"acceleration of {name}", " s²/rad", np.gradient(moving, t)),
        ]
    return listed
