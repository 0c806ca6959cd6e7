"""Loads of the joints of a log from the options ``--inertia`` and ``--pendulum``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from sim2real.errors import InputError
from sim2real.recording import Load, Recording

INERTIA = "J=KGM2, a number above 0"
PENDULUM = "J=MASS_KG,LENGTH_M, two numbers above 0"
_ROUNDING = 1e-6


def with_loads(
    recording: Recording, inertia: Sequence[str] | None, pendulum: Sequence[str] | None
) -> Recording:
    """The recording with loads stated by joint, which replace those of its log.

    Args:
        recording: The recording.
        inertia: ``J=KGM2``: inertia of the load in kg m2, with the pendulum and without the rotor.
        pendulum: ``J=MASS_KG,LENGTH_M``: a point mass in kg that hangs straight down at angle 0,
            and its distance from the shaft in m. Without a stated inertia the load is this mass
            only, ``mass length^2``.

    Raises:
        InputError: If one of them is not of that form, names a joint that was not recorded, or an
            inertia is less than that of its pendulum.
    """
    loads = loads_of(inertia, pendulum, recording.joints)
    return replace(recording, loads={**recording.loads, **loads})


def loads_of(
    inertia: Sequence[str] | None, pendulum: Sequence[str] | None, joints: Sequence[str]
) -> dict[str, Load]:
    """Loads stated by joint, see ``with_loads``.

    Raises:
        InputError: See ``with_loads``.
    """
    totals = _by_joint("--inertia", inertia, joints, 1, INERTIA)
    hanging = _by_joint("--pendulum", pendulum, joints, 2, PENDULUM)
    loads = {joint: Load(value) for joint, (value,) in totals.items()}
    for joint, (mass, length) in hanging.items():
        pendulum_inertia = mass * length**2
        total = totals[joint][0] if joint in totals else pendulum_inertia
        if total < pendulum_inertia * (1 - _ROUNDING):
            problem = f"{total:g} kg m2, less than the pendulum's {pendulum_inertia:g}"
            raise InputError(
                "--inertia", joint, problem, "the load with its pendulum, without the rotor"
            )
        loads[joint] = Load(total, mass, length)
    return loads


def _by_joint(
    option: str, texts: Sequence[str] | None, joints: Sequence[str], count: int, form: str
) -> dict[str, list[float]]:
    """The numbers of each joint in an option."""
    values: dict[str, list[float]] = {}
    for text in texts or ():
        joint, _, value = text.rpartition("=")
        numbers = _numbers(value)
        if joint not in joints or len(numbers) != count or joint in values:
            expected = f"{form}, once for a joint of {', '.join(joints)}"
            raise InputError(option, "", repr(text), expected)
        values[joint] = numbers
    return values


def _numbers(text: str) -> list[float]:
    """Positive numbers separated by commas; empty if one is invalid."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        return []
    return numbers if all(x > 0 and math.isfinite(x) for x in numbers) else []
