"""A recording: commands and measured angles of each joint, sample by sample."""

import os
import shlex
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
import pandas as pd

from sim2real import csv_columns
from sim2real.arrays import Array
from sim2real.clock import LONGEST_COMMAND_PERIOD_S, check_sampling, missing_samples, timing
from sim2real.display import NotebookDisplay
from sim2real.errors import InputError
from sim2real.output import beside, write_json, write_whole
from sim2real.structured import Fields, check_label, read_json

SCHEMA = "sim2real.recording/1"
POSE = ("body.x_m", "body.y_m", "body.yaw_rad")
"""Columns of the pose of a swimming robot."""
GRAVITY_M_S2 = 9.80665
FIELDS = ("schema", "kind", "joints", "loads", "medium", "source")
"""Known fields of the JSON file; other fields are preserved as ``metadata``."""


@dataclass(frozen=True)
class Load:
    """Load on the output shaft of a bench servo: inertia, and a pendulum if there is one."""

    inertia_kgm2: float  # about the shaft, pendulum included
    pendulum_mass_kg: float = 0.0  # mass of a point hanging straight down at position 0
    pendulum_length_m: float = 0.0  # distance of that mass from the shaft

    @property
    def gravity_Nm(self) -> float:
        """Torque in N m of the pendulum's weight in horizontal position."""
        return self.pendulum_mass_kg * GRAVITY_M_S2 * self.pendulum_length_m


PER_INERTIA = Load(inertia_kgm2=1.0)
"""Placeholder for an unknown load: gains are then per unit of inertia."""


@dataclass(frozen=True)
class VaryingLoad:
    """A load that the other joints of an arm cause, at evenly spaced times, linear between them."""

    start_s: float  # time of the first value, on the clock of the recording
    step_s: float  # time between values
    inertia_kgm2: Array  # about the shaft, shape (K,), K at least 2
    torque_Nm: Array  # on the shaft, gravity included, shape (K,)

    @cached_property
    def mean_inertia_kgm2(self) -> float:
        """Mean inertia, which stands for the load where a single number is needed."""
        return float(np.mean(self.inertia_kgm2))


@dataclass(frozen=True)
class Recording(NotebookDisplay):
    """One recording."""

    name: str  # file name without extension
    kind: str  # ``"servo"`` (a bench) or ``"pool"`` (the robot swims)
    joints: tuple[str, ...]  # names of the J joints
    t: Array  # times in s, shape (T,), increasing, with jitter and gaps as recorded
    command: Array
    """Set-points in rad, shape (T, J). NaN only after the last command of a joint, where its torque
    is off, or everywhere if commands were not recorded (pool only)."""
    position: Array  # measured angles in rad, shape (T, J); NaN where a sample is missing
    loads: Mapping[str, Load] = field(default_factory=dict)  # known loads by joint name
    medium: str = "air"  # or ``"water"``
    source: str = ""
    columns: Mapping[str, Array] = field(default_factory=dict)  # all others by name, shape (T,)
    metadata: Mapping[str, Any] = field(default_factory=dict)  # other fields of the JSON file
    path: Path | None = None  # the CSV file, if it was read from one
    varying_loads: Mapping[str, VaryingLoad] = field(default_factory=dict)
    """Loads that vary with time, by joint, from the robot (``sim2real.arm``); not in the file."""

    @property
    def file(self) -> str:
        """Name of the file, for messages."""
        return str(self.path or f"{self.name}.csv")

    @property
    def duration_s(self) -> float:
        """Time between the first and the last sample, in s."""
        return float(self.t[-1] - self.t[0])

    @property
    def rate_hz(self) -> float:
        """Inverse of the median time between measurements, see ``timing``; NaN for one row."""
        return timing(self.t, self.position).rate_hz if self.t.size > 1 else float("nan")

    @property
    def has_poses(self) -> bool:
        """Whether the pose of the body was tracked."""
        return "body.x_m" in self.columns

    @property
    def is_simulated(self) -> bool:
        """Whether its JSON states that a simulator wrote it (``"simulated": true``)."""
        return self.metadata.get("simulated") is True

    @property
    def is_swim(self) -> bool:
        """Whether this is a swim whose body was tracked, not a recording of a bench."""
        return self.kind == "pool" and self.has_poses

    def moves(self, joint: str) -> bool:
        """Whether the command and the measured angle of a joint change."""
        j = self.joints.index(joint)
        columns = (self.command[: self.powered(j), j], self.position[: self.powered(j), j])
        return all(np.unique(x[np.isfinite(x)]).size > 1 for x in columns)

    def without(self, joints: Collection[str]) -> Self:
        """The recording without some of its joints."""
        if not joints:
            return self
        kept = [j for j, joint in enumerate(self.joints) if joint not in joints]
        names = tuple(self.joints[j] for j in kept)
        return replace(
            self,
            joints=names,
            command=self.command[:, kept],
            position=self.position[:, kept],
            loads={name: load for name, load in self.loads.items() if name in names},
        )

    def missing(self, joint: int) -> int:
        """Number of missing positions of joint ``joint``; rows of set-points only lack none."""
        return missing_samples(self.t, self.position[:, joint])

    @property
    def summary(self) -> str:
        """Kind, medium, duration, samples, rate and number of missing positions, on one line."""
        duration = self.duration_s if self.t.size else 0.0
        missing = sum(self.missing(j) for j in range(len(self.joints)))
        return (
            f"{self.kind} in {self.medium}, {duration:.2f} s, {self.t.size} samples at "
            f"{self.rate_hz:.4g} Hz, {missing} positions missing"
        )

    def __repr__(self) -> str:
        return f"<Recording {self.name}: {self.summary}; joints {', '.join(self.joints)}>"

    @property
    def commands(self) -> dict[str, Array]:
        """Set-points in rad by joint, each of shape (T,)."""
        return dict(zip(self.joints, self.command.T, strict=True))

    def powered(self, joint: int) -> int:
        """Number of samples before the torque of joint ``joint`` is switched off, at most T."""
        commanded = np.flatnonzero(np.isfinite(self.command[:, joint]))
        return int(commanded[-1]) + 1 if commanded.size else 0

    def between(self, start: int, stop: int) -> Self:
        """Recording of the samples ``start`` to ``stop`` (exclusive)."""
        part = slice(start, stop)
        return replace(
            self,
            t=self.t[part],
            command=self.command[part],
            position=self.position[part],
            columns={name: values[part] for name, values in self.columns.items()},
        )


def read_recording(path: str | os.PathLike[str]) -> Recording:
    """Read and validate ``NAME.csv`` and ``NAME.json`` in the same folder."""
    csv = Path(path)
    sidecar = csv.with_suffix(".json")
    if os.path.isdir(csv):  # perhaps of a ROS bag
        raise InputError(csv, "", "a folder", f"the CSV file of a recording; {_import_first(csv)}")
    if os.path.isfile(csv) and not os.path.exists(sidecar):
        expected = f"the file that belongs to each recording; {_import_first(csv)}"
        raise InputError(sidecar, "", "no such file", expected)
    table = csv_columns.read_table(csv)
    top = Fields(sidecar, "", read_json(sidecar, SCHEMA))
    top.refuse_unknown(FIELDS, misspelt=True)
    kind = top.text("kind")
    if kind not in ("servo", "pool"):
        raise top.error("kind", "'servo' or 'pool'")
    names = top.content.get("joints")
    if not isinstance(names, list) or not names or not all(isinstance(n, str) for n in names):
        raise top.error("joints", "a list of joint names")
    if len(set(names)) != len(names):
        raise top.error("joints", "each name once")
    joints = tuple(check_label(sidecar, "joints", name) for name in names)
    t = csv_columns.times(csv, table)
    check_sampling(csv, t)
    command = np.full((t.size, len(joints)), np.nan)
    if kind == "servo" or any(f"{j}.command_rad" in table for j in joints):
        command = csv_columns.commands(csv, table, joints)
    position = csv_columns.angles(csv, table, joints, "position_rad")
    used = {"t_s"} | {f"{j}.{c}" for j in joints for c in ("command_rad", "position_rad")}
    others = [str(name) for name in table.columns if name not in used]
    columns = {name: csv_columns.column(csv, table, name) for name in others}
    recording = Recording(csv.stem, kind, joints, t, command, position, columns=columns, path=csv)
    return _stated(top, recording)


def _stated(top: Fields, recording: Recording) -> Recording:
    """The recording with what its JSON file states."""
    loads, table = {}, top.table("loads")
    for name in table.content:
        if name not in recording.joints:
            expected = ", ".join(recording.joints)
            raise InputError(top.file, f"loads.{name}", "a joint not recorded", expected)
        loads[name] = read_load(table.table(name))
    return replace(
        recording,
        loads=loads,
        medium=top.text("medium", "air"),
        source=top.text("source", ""),
        metadata={k: x for k, x in top.content.items() if k not in FIELDS},
    )


def _import_first(log: Path) -> str:
    """What to do with a log that is not a recording yet."""
    out = f"{log.resolve().stem}_imported.csv"
    command = shlex.join(["sim2real", "import", str(log), "--out", out])
    return f"import the log {log.name} first: {command}"


def read_commands(path: str | os.PathLike[str]) -> Recording:
    """Read the commands of a CSV file, with loads of its JSON file if any; positions are NaN."""
    csv = Path(path)
    table = csv_columns.read_table(csv)
    t = csv_columns.times(csv, table)
    check_sampling(csv, t, LONGEST_COMMAND_PERIOD_S)
    names = [str(column) for column in table.columns]
    joints = tuple(n.removesuffix(".command_rad") for n in names if n.endswith(".command_rad"))
    if not joints:
        raise InputError(csv, "header", "no J.command_rad column", "one for each joint")
    command = csv_columns.commands(csv, table, joints)
    sidecar = csv.with_suffix(".json")
    top = Fields(sidecar, "", read_json(sidecar, SCHEMA) if sidecar.exists() else {})
    missing = np.full_like(command, np.nan)
    return _stated(top, Recording(csv.stem, "servo", joints, t, command, missing, path=csv))


def write_recording(
    recording: Recording, path: str | os.PathLike[str], *, measured: bool = True
) -> None:
    """Write ``NAME.csv`` and ``NAME.json``, from which ``read_recording`` restores the recording.

    If not ``measured``, measured angles are left out, and ``read_commands`` reads it.
    """
    csv = Path(path)
    for joint in recording.joints:
        check_label(csv, "joints", joint)
    table: dict[str, Array] = {"t_s": recording.t}
    for j, joint in enumerate(recording.joints):
        if np.isfinite(recording.command[:, j]).any():
            table[f"{joint}.command_rad"] = recording.command[:, j]
        if measured:
            table[f"{joint}.position_rad"] = recording.position[:, j]
    table |= recording.columns
    sidecar = {
        "schema": SCHEMA,
        **{name: getattr(recording, name) for name in ("kind", "joints", "medium", "source")},
        "loads": {name: vars(load) for name, load in recording.loads.items()},
        **recording.metadata,
    }
    write_whole(csv, pd.DataFrame(table).round(9).to_csv(index=False))
    write_json(beside(csv, f"{csv.stem}.json"), sidecar)


def read_load(fields: Fields) -> Load:
    """Read a load from its table; the pendulum is optional."""
    fields.refuse_unknown(Load.__annotations__, misspelt=True)
    return Load(
        inertia_kgm2=fields.number("inertia_kgm2", above=0),
        pendulum_mass_kg=fields.number("pendulum_mass_kg", 0.0, low=0),
        pendulum_length_m=fields.number("pendulum_length_m", 0.0, low=0),
    )
