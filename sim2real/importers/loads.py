"""Loads of a log's joints, as the command line states them: ``--inertia`` and ``--pendulum``."""

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
    """The recording with loads stated by joint, in place of those that its log states.

    Args:
        recording: The recording.
        inertia: ``J=KGM2``: everything that the output shaft turns in kg m2, pendulum included.
        pendulum: ``J=MASS_KG,LENGTH_M``: a point mass in kg that hangs straight down at angle 0,
            and its distance from the shaft in m. Where no inertia is stated beside it the load is
            this mass alone, ``mass length^2``.

    Raises:
        InputError: If one of them is not of that form, names a joint that was not recorded, or an
            inertia is less than its pendulum's.
    """
    whole = _by_joint("--inertia", inertia, recording.joints, 1, INERTIA)
    hanging = _by_joint("--pendulum", pendulum, recording.joints, 2, PENDULUM)
    loads = {joint: Load(value) for joint, (value,) in whole.items()}
    for joint, (mass, length) in hanging.items():
        own = mass * length**2
        total = whole[joint][0] if joint in whole else own
        if total < own * (1 - _ROUNDING):
            found = f"{total:g} kg m2, less than the pendulum's {own:g}"
            raise InputError(
                "--inertia", joint, found, "everything on the shaft, pendulum included"
            )
        loads[joint] = Load(total, mass, length)
    return replace(recording, loads={**recording.loads, **loads})


def _by_joint(
    option: str, texts: Sequence[str] | None, joints: Sequence[str], count: int, form: str
) -> dict[str, list[float]]:
    """The numbers of each joint that an option states."""
    values: dict[str, list[float]] = {}
    for text in texts or ():
        joint, _, rest = text.rpartition("=")
        numbers = _numbers(rest)
        if joint not in joints or len(numbers) != count or joint in values:
            expected = f"{form}, once for a joint of {', '.join(joints)}"
            raise InputError(option, "", repr(text), expected)
        values[joint] = numbers
    return values


def _numbers(text: str) -> list[float]:
    """Numbers above 0, separated by commas; none where one of them is not."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        return []
    return numbers if all(x > 0 and math.isfinite(x) for x in numbers) else []
