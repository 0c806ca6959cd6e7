"""Logs of BAM, Better Actuator Models (Rhoban, github.com/Rhoban/bam): one servo, one pendulum."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import numpy as np

from sim2real.arrays import Array
from sim2real.csv_columns import LARGEST_ANGLE_RAD
from sim2real.errors import InputError, shown
from sim2real.importers.options import import_warnings
from sim2real.recording import Load, Recording
from sim2real.structured import Fields, read_json

SAMPLE = ("timestamp", "goal_position", "torque_enable", "position")
COLUMNS = {"speed": "j1.velocity_rad_s", "load": "j1.load", "temp": "j1.temperature_C"}
COLUMNS |= {"input_volts": "supply_V"}
TEXTS = {"motor": "servo", "trajectory": "trajectory"}
NUMBERS = {"kp": "firmware_p_gain", "damping": "damping_gain", "vin": "supply_nominal_V"}
NUMBERS |= {"dt": "resampled_every_s"}
TOP = ("mass", "arm_mass", "length", "entries", *TEXTS, *NUMBERS)


def read_bam(path: str | os.PathLike[str]) -> Recording:
    """Read a raw (or resampled) BAM log, a JSON file, as a ``servo`` recording of joint ``j1``.

    Commands are empty while the torque is off, which is imported only at the end of a recording: if
    the torque is switched on again, the rest is omitted, as stated in ``metadata["left_out"]``.
    Speed, load, temperature and supply become columns if they were measured (a recorder writes 0
    throughout, or nothing, if not); ``metadata["not_imported"]`` lists the other fields. A hyphen
    in the name of a field, as in ``arm-mass``, is read as an underscore. ``InputError`` if a field
    does not conform to the format or the torque is off at the start.
    """
    top = _top(path)
    load, source = _load(top)
    entries = top.content.get("entries")
    if not isinstance(entries, list) or len(entries) < 2:
        found = f"{len(entries)} samples" if isinstance(entries, list) else "no list of samples"
        raise InputError(top.file, "entries", found, "at least two samples of a BAM log")
    samples = [Fields(top.file, f"entries[{k}]", entry) for k, entry in enumerate(entries)]
    t = np.array([sample.number("timestamp") for sample in samples])
    decreasing = np.flatnonzero(np.diff(t) <= 0)
    if decreasing.size:
        k = int(decreasing[0])
        raise samples[k + 1].error("timestamp", f"a time after {t[k]:g} s")
    off, stop = _torque(samples)
    command = [_angle(sample, "goal_position") for sample in samples[:off]]
    position = [_angle(sample, "position") for sample in samples]
    read = {name: _optional(samples, name) for name in COLUMNS}
    measured = {name: values[:stop] for name, values in read.items() if values is not None}
    others = {str(name) for sample in samples for name in sample.content} - {*SAMPLE, *measured}
    unknown = [str(name) for name in top.content if name not in TOP]
    unknown += [f"entries.{name}" for name in sorted(others - set(COLUMNS))]
    metadata: dict[str, Any] = {ours: top.text(n) for n, ours in TEXTS.items() if n in top}
    metadata |= {ours: top.number(name) for name, ours in NUMBERS.items() if name in top}
    metadata |= {"original_file": Path(path).name, "not_imported": sorted(others)}
    if unknown:
        sentence = f"Unknown fields of the log are not read: {', '.join(unknown)}."
        metadata |= import_warnings([sentence])
    if off < stop:
        metadata["torque_off_from_s"] = float(t[off])
    if stop < t.size:
        why = "the torque comes on again"
        metadata["left_out"] = {"from_s": float(t[stop]), "rows": t.size - stop, "why": why}
    return Recording(
        name=Path(path).stem,
        kind="servo",
        joints=("j1",),
        t=t[:stop],
        command=np.array(command + [math.nan] * (stop - off))[:, None],
        position=np.array(position[:stop])[:, None],
        loads={"j1": load},
        source=source,
        columns={COLUMNS[name]: values for name, values in measured.items()},
        metadata=metadata,
    )


def _top(path: str | os.PathLike[str]) -> Fields:
    """The fields of a log, with the known names that BAM's recorders write with a hyphen."""
    content = read_json(path)
    for name in [name for name in content if "-" in name]:
        ours = name.replace("-", "_")
        if ours in TOP:
            value = content.pop(name)
            if content.setdefault(ours, value) != value:
                expected = f"the value of {ours}, {shown(content[ours])}"
                raise InputError(path, name, shown(value), expected)
    return Fields(path, "", content)


def _load(top: Fields) -> tuple[Load, str]:
    """The load of BAM's test bench, and a description of the log.

    A point mass m at the end of a uniform rod of length l has the inertia m l^2 + m_arm l^2 / 3.
    Gravity acts on the rod at half its length, so the point mass at l with the same gravity torque
    is m + m_arm / 2.
    """
    mass, arm = top.number("mass", low=0), top.number("arm_mass", 0.0, low=0)
    length = top.number("length", above=0)
    if mass + arm <= 0:
        raise top.error("mass", "a mass above 0, or an arm_mass")
    load = "inertia_kgm2 is mass*length^2: arm and rotor are not in it."
    if arm > 0:
        load = "inertia_kgm2 is mass*length^2 + arm_mass*length^2/3, without the rotor; the point "
        load += "mass mass + arm_mass/2 at that length has the gravity torque of weight and arm."
    source = (
        "Log in the format of Rhoban's BAM, Better Actuator Models (github.com/Rhoban/bam); "
        f"licence not stated in the log. {load} Position 0 is taken to hang straight down. A "
        "set-point left a few milliseconds, how many was not logged, before its t_s."
    )
    return Load((mass + arm / 3) * length**2, mass + arm / 2, length), source


def _torque(samples: list[Fields]) -> tuple[int, int]:
    """Index of the first sample with the torque off, and of the first with it on again."""
    enabled = [sample.content.get("torque_enable") for sample in samples]
    for sample, on in zip(samples, enabled, strict=True):
        if not isinstance(on, bool):
            raise sample.error("torque_enable", "true or false")
    if not enabled[0]:
        raise samples[0].error("torque_enable", "true: a recording starts on its first command")
    off = enabled.index(False) if False in enabled else len(enabled)
    return off, enabled.index(True, off) if True in enabled[off:] else len(enabled)


def _angle(sample: Fields, name: str) -> float:
    angle = sample.number(name)
    if abs(angle) > LARGEST_ANGLE_RAD:
        raise sample.error(name, f"radians within {LARGEST_ANGLE_RAD:.1f} (degrees, perhaps?)")
    return angle


def _optional(samples: list[Fields], name: str) -> Array | None:
    """Values of an optional field, shape (T,), NaN where missing; None if it was not measured."""
    present = np.array([sample.content.get(name) is not None for sample in samples])
    values = np.full(present.size, np.nan)
    values[present] = [samples[k].number(name) for k in np.flatnonzero(present)]
    if not np.nan_to_num(values).any():
        return None
    negative = values >= 2**15
    if name != "load" or not negative.any():
        return values
    # The XL330's recorder logs a signed 16-bit register as unsigned: -1 is logged as 65535.
    # Resampling interpolates between 0 and 65535, which cannot be undone.
    return None if (values[present] % 1).any() else np.where(negative, values - 2**16, values)
