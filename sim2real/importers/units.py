"""Units of logged angles, which the caller has to state."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim2real.arrays import Array
from sim2real.csv_columns import LARGEST_ANGLE_RAD
from sim2real.errors import InputError
from sim2real.structured import Fields, read_json

RADIANS_PER = {"rad": 1.0, "deg": math.pi / 180, "turns": 2 * math.pi}
RANGES = {"range_m100_100": (-100.0, 100.0), "range_0_100": (0.0, 100.0)}
ANGLES = ("command", "position")
ANGLE_UNITS = (*RADIANS_PER, "counts", *RANGES)
SECONDS_PER = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


@dataclass(frozen=True)
class Conversion:
    """Conversion of the angles of a log to radians.

    Attributes:
        units: Unit of each joint by name, of ``J.command`` or ``J.position`` alone, and of all
            others under ``""``.
        counts_per_turn: Encoder counts per turn of the output shaft, for ``counts`` and the
            calibrated ranges.
        zero_count: The count at angle 0; default: the middle of the calibrated range.
        calibration: A LeRobot calibration file: for each joint ``range_min`` and ``range_max`` in
            counts.
    """

    units: Mapping[str, str]
    counts_per_turn: int | None = None
    zero_count: float | None = None
    calibration: str | os.PathLike[str] | None = None

    def check_joints(self, joints: Sequence[str]) -> None:
        """Check that units are stated for joints of the log only.

        Raises:
            InputError: If one is stated for a joint that the log lacks.
        """
        known = {"", *joints, *(f"{joint}.{quantity}" for joint in joints for quantity in ANGLES)}
        unknown = [name for name in self.units if name not in known]
        if unknown:
            expected = f"joints of {', '.join(joints)}, or one's command or position"
            raise InputError("--units", "", ", ".join(unknown), expected)

    def unit(self, joint: str, quantity: str) -> str:
        """Unit of the commands or positions of a joint.

        Raises:
            InputError: If it is missing or unknown.
        """
        names = (f"{joint}.{quantity}", joint, "")
        unit = next((self.units[name] for name in names if name in self.units), None)
        if unit is None:
            expected = f"{joint}=UNIT, of {', '.join(ANGLE_UNITS)}"
            raise InputError("--units", "", f"none for {joint}", expected)
        if unit not in ANGLE_UNITS:
            raise InputError("--units", joint, repr(unit), f"one of {', '.join(ANGLE_UNITS)}")
        return unit

    def radians(
        self, joint: str, quantity: str, values: Array, where: str | os.PathLike[str]
    ) -> Array:
        """Commands or positions of a joint in rad, of the shape of ``values``.

        A calibrated range (LeRobot's ``RANGE_M100_100`` and ``RANGE_0_100``) spans from
        ``range_min`` to ``range_max``, its middle is angle 0, as with LeRobot's degrees, and its
        direction is that of the log.

        Raises:
            InputError: If the unit or a value that it needs is missing, or an angle is too large.
        """
        unit = self.unit(joint, quantity)
        angles = values * RADIANS_PER.get(unit, 1.0)
        if unit in RANGES:
            low, high = RANGES[unit]
            lowest, highest = self._span(joint)
            counts = (values - (low + high) / 2) / (high - low) * (highest - lowest)
            angles = counts * self._per_count(unit)
        elif unit == "counts":
            angles = (values - self._zero(joint)) * self._per_count(unit)
        largest = float(np.nanmax(np.abs(angles), initial=0.0))
        if largest > LARGEST_ANGLE_RAD:
            found = f"{largest:.4g} rad, if angles are {unit}"
            raise InputError(
                where, f"{joint}, {quantity}", found, f"at most {LARGEST_ANGLE_RAD:.1f} rad"
            )
        return angles

    def _per_count(self, unit: str) -> float:
        if not self.counts_per_turn or self.counts_per_turn < 2:
            expected = f"counts in a turn of the shaft, for the unit {unit}"
            raise InputError("--counts-per-turn", "", str(self.counts_per_turn), expected)
        return 2 * math.pi / self.counts_per_turn

    def _zero(self, joint: str) -> float:
        if self.zero_count is not None:
            return self.zero_count
        if self.calibration is None:
            expected = "the count that is angle 0, or --calibration"
            raise InputError("--zero-count", "", "nothing", expected)
        return sum(self._span(joint)) / 2

    def _span(self, joint: str) -> tuple[float, float]:
        if self.calibration is None:
            raise InputError("--calibration", "", "nothing", "the robot's calibration file (.json)")
        top = Fields(self.calibration, "", read_json(self.calibration))
        if joint not in top:
            known = ", ".join(str(name) for name in top.content) or "no joint"
            raise InputError(self.calibration, joint, "nothing", f"one of {known}")
        fields = top.table(joint)
        first = fields.number("range_min")
        return first, fields.number("range_max", above=first)


def conversion(
    units: Sequence[str] | None,
    counts_per_turn: int | None = None,
    zero_count: float | None = None,
    calibration: str | os.PathLike[str] | None = None,
) -> Conversion:
    """The conversion for ``--units UNIT`` or ``--units UNIT JOINT=UNIT JOINT.command=UNIT ...``.

    Raises:
        InputError: If no unit is stated, or a unit is unknown.
    """
    if not units:
        expected = f"the unit of the angles: {', '.join(ANGLE_UNITS)}"
        raise InputError("--units", "", "nothing", expected)
    by_joint = {}
    for text in units:
        joint, _, unit = text.rpartition("=")
        if unit not in ANGLE_UNITS:
            raise InputError("--units", "", repr(text), f"one of {', '.join(ANGLE_UNITS)}")
        if joint in by_joint:
            raise InputError("--units", "", f"two for {joint or 'all joints'}", "one")
        by_joint[joint] = unit
    return Conversion(by_joint, counts_per_turn, zero_count, calibration)
