"""What a log does not state, from options: units of its angles, loads of its joints."""

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim2real.arrays import Array
from sim2real.csv_columns import LARGEST_ANGLE_RAD
from sim2real.errors import InputError
from sim2real.recording import Load
from sim2real.structured import Fields, read_json

RADIANS_PER = {"rad": 1.0, "deg": math.pi / 180, "turns": 2 * math.pi}
RANGES = {"range_m100_100": (-100.0, 100.0), "range_0_100": (0.0, 100.0)}
ANGLES = ("command", "position")
ANGLE_UNITS = (*RADIANS_PER, "counts", *RANGES)
SECONDS_PER = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
MAP = "t=COLUMN J.command=COLUMN J.position=COLUMN ..."
INERTIA = "J=KGM2, a number above 0"
PENDULUM = "J=MASS_KG,LENGTH_M, two numbers above 0"


@dataclass(frozen=True)
class Conversion:
    """Conversion of the angles of a log to radians, see `conversion`."""

    # unit of each joint by name, of ``J.command`` or ``J.position`` alone, and of all others under
    # ``""``
    units: Mapping[str, str]
    # encoder counts per turn of the output shaft, for ``counts`` and the calibrated ranges; 0 if no
    # unit needs it
    counts_per_turn: int = 0
    # the count at angle 0; default: the middle of the calibrated range
    zero_count: float | None = None
    # a LeRobot calibration file: for each joint ``range_min`` and ``range_max`` in counts; empty if
    # no unit needs it
    calibration: str | os.PathLike[str] = ""

    def radians(
        self, joints: Sequence[str], quantity: str, values: Array, where: str | os.PathLike[str]
    ) -> Array:
        """Commands or positions of joints in rad, of the shape of ``values`` (T, J).

        A calibrated range (LeRobot's ``RANGE_M100_100`` and ``RANGE_0_100``) spans from
        ``range_min`` to ``range_max``; its middle is angle 0, as with LeRobot's degrees.
        ``InputError`` unless units are stated for all joints, and for these only, if the
        calibration lacks a joint, or an angle is too large.
        """
        known = {"", *joints, *(f"{joint}.{name}" for joint in joints for name in ANGLES)}
        if unknown := ", ".join(name for name in self.units if name not in known):
            expected = f"joints of {', '.join(joints)}, or one's command or position"
            raise InputError("--units", "", unknown, expected)
        angles = np.empty_like(values)
        for j, joint in enumerate(joints):
            names = (f"{joint}.{quantity}", joint, "")
            unit = next((self.units[name] for name in names if name in self.units), None)
            if unit is None:
                expected = f"{joint}=UNIT, of {', '.join(ANGLE_UNITS)}"
                raise InputError("--units", "", f"none for {joint}", expected)
            angles[:, j] = self._angles(joint, unit, values[:, j])
            largest = float(np.nanmax(np.abs(angles[:, j]), initial=0.0))
            if largest > LARGEST_ANGLE_RAD:
                found = f"{largest:.4g} rad, if angles are {unit}"
                expected = f"at most {LARGEST_ANGLE_RAD:.1f} rad"
                raise InputError(where, f"{joint}, {quantity}", found, expected)
        return angles

    def _angles(self, joint: str, unit: str, values: Array) -> Array:
        """Values of one joint in rad."""
        if unit in RADIANS_PER:
            return values * RADIANS_PER[unit]
        if unit in RANGES:
            low, high = RANGES[unit]
            lowest, highest = self._span(joint)
            counts = (values - (low + high) / 2) / (high - low) * (highest - lowest)
        else:
            zero = self.zero_count
            counts = values - (sum(self._span(joint)) / 2 if zero is None else zero)
        return counts * (2 * math.pi / self.counts_per_turn)

    def _span(self, joint: str) -> tuple[float, float]:
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
    *,
    source: str | os.PathLike[str] = "--units",
    lacking: Sequence[str] = (),
) -> Conversion:
    """The conversion for ``--units UNIT`` or ``--units UNIT JOINT=UNIT JOINT.command=UNIT ...``.

    ``lacking`` are other options of the log that are missing, each with its expected value.
    ``InputError`` if a unit, or what it needs, is missing, a unit is unknown, or a value does not
    apply to any of the units.
    """
    by_joint: dict[str, str] = {}
    for text in units or ():
        joint, _, unit = text.rpartition("=")
        if unit not in ANGLE_UNITS:
            raise InputError("--units", "", repr(text), f"one of {', '.join(ANGLE_UNITS)}")
        if joint in by_joint:
            raise InputError("--units", "", f"two for {joint or 'all joints'}", "one")
        by_joint[joint] = unit
    counts = "counts" in by_joint.values()
    ranges = bool(RANGES.keys() & set(by_joint.values()))
    no_turn = ["--counts-per-turn N"] if (counts_per_turn or 0) < 2 else []
    no_zero = ["--zero-count N"] if zero_count is None and calibration is None else []
    missing = list(lacking)
    if not units:
        remark = f" (for counts also {' '.join(no_turn + no_zero)})" if no_turn + no_zero else ""
        missing.append(f"--units {'|'.join(ANGLE_UNITS)}{remark}")
    if (counts or ranges) and no_turn:
        missing.append(f"{no_turn[0]} (of a turn of the shaft)")
    if counts and no_zero:
        missing.append(f"{no_zero[0]} (the count at angle 0) or --calibration JSON")
    if ranges and calibration is None:
        missing.append("--calibration JSON")
    ask_for(source, missing)
    given: dict[str, object] = {"counts_per_turn": counts_per_turn, "zero_count": zero_count}
    given["calibration"] = calibration
    used = (counts or ranges, counts, ranges or (counts and zero_count is None))
    unused = [n for n, use in zip(given, used, strict=True) if given[n] is not None and not use]
    refuse(source, unused, f"angles in {', '.join(units or ())}", ["units"])
    return Conversion(by_joint, counts_per_turn or 0, zero_count, calibration or "")


def ask_for(source: str | os.PathLike[str], lacking: Sequence[str]) -> None:
    """Raise one ``InputError`` for all missing options, if there are any."""
    if lacking:
        names = ", ".join(text.split(" ")[0] for text in lacking)
        raise InputError(source, "", f"no {names}", "; ".join(lacking))


def refuse(
    source: str | os.PathLike[str], options: Sequence[str], of: str, applicable: Sequence[str]
) -> None:
    """Raise one ``InputError`` for all options of a log that do not apply ``of`` its kind."""
    if options:
        wrong, right = (
            ", ".join(f"--{name.replace('_', '-')}" for name in names)
            for names in (options, applicable)
        )
        raise InputError(source, "", f"{wrong} for {of}", f"only options that apply to it: {right}")


def import_warnings(sentences: Sequence[str]) -> dict[str, list[str]]:
    """The field of a recording's metadata with what its user should know; none if empty."""
    return {"import_warnings": list(sentences)} if sentences else {}


def check_increasing(file: str | os.PathLike[str], t: Array, place: str, first: int) -> None:
    """Raise ``InputError`` unless times (T,) in s increase; ``place`` has the number's place."""
    decreasing = np.flatnonzero(~(np.diff(t) > 0))
    if decreasing.size:
        k = int(decreasing[0]) + 1
        found = f"{t[k]:g} s after {t[k - 1]:g} s"
        raise InputError(file, place.format(k + first), found, "times that increase")


def loads_of(
    inertia: Sequence[str] | None, pendulum: Sequence[str] | None, joints: Sequence[str]
) -> dict[str, Load]:
    """Loads by joint, of options ``J=KGM2`` and ``J=MASS_KG,LENGTH_M``.

    The inertia in kg m2 is that of the load with its pendulum, without the rotor; the pendulum is a
    point mass that hangs straight down at angle 0. Without an inertia the load is this mass only.
    ``InputError`` if one is not of that form, names a joint that was not recorded, or an inertia is
    less than that of its pendulum.
    """
    totals = _by_joint("--inertia", inertia, joints, 1, INERTIA)
    loads = {joint: Load(value) for joint, (value,) in totals.items()}
    for joint, (mass, length) in _by_joint("--pendulum", pendulum, joints, 2, PENDULUM).items():
        least = mass * length**2
        total = totals[joint][0] if joint in totals else least
        if total < least * (1 - 1e-6):
            found = f"{total:g} kg m2, less than the pendulum's {least:g}"
            expected = "the load with its pendulum, without the rotor"
            raise InputError("--inertia", joint, found, expected)
        loads[joint] = Load(total, mass, length)
    return loads


def _by_joint(
    option: str, texts: Sequence[str] | None, joints: Sequence[str], count: int, form: str
) -> dict[str, list[float]]:
    """The numbers of each joint in an option."""
    values: dict[str, list[float]] = {}
    for text in texts or ():
        joint, _, value = text.rpartition("=")
        try:
            numbers = [float(part) for part in value.split(",")]
        except ValueError:
            numbers = []
        valid = len(numbers) == count and all(0 < x < math.inf for x in numbers)
        if joint not in joints or joint in values or not valid:
            expected = f"{form}, once for a joint of {', '.join(joints)}"
            raise InputError(option, "", repr(text), expected)
        values[joint] = numbers
    return values
