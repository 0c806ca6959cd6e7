"""Logs of all tools: which kind a log is, which options it takes, and its reader."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sim2real.clock import check_sampling
from sim2real.errors import InputError
from sim2real.importers.bam import is_bam_parameters, read_bam, read_bam_parameters
from sim2real.importers.lerobot import is_lerobot, read_lerobot
from sim2real.importers.options import (
    MAP,
    SECONDS_PER,
    Conversion,
    ask_for,
    conversion,
    loads_of,
    refuse,
)
from sim2real.importers.rosbag import read_bag
from sim2real.importers.tables import column_map, read_table
from sim2real.model import Model, write_model
from sim2real.output import check_writable
from sim2real.recording import Recording, write_recording
from sim2real.structured import read_json

BAGS = (".bag", ".db3", ".mcap")
TABLES = (".csv", ".tsv")
KINDS = f"a BAM log (.json), a ROS bag (a folder, {', '.join(BAGS)}), a LeRobot dataset (a folder "
KINDS += f"with meta/info.json) or a table ({', '.join(TABLES)})"
LOADS = ("inertia", "pendulum")
ANGLES = ("units", "counts_per_turn", "zero_count", "calibration")
"""Options of angles, in the order of ``conversion``."""
OPTIONS = {
    "a BAM log": LOADS,
    "BAM's parameters": LOADS,
    "a ROS bag": ("state_topic", "command_topic", "joints", *LOADS),
    "a LeRobot dataset": (*ANGLES, "episode", "joints", *LOADS),
    "a table": ("columns", "time_unit", *ANGLES, *LOADS),
}
"""Options of each kind of log."""
LISTS = ("command_topic", "joints", "units", "columns", *LOADS)
"""Options with several values; one value may be a text."""
STATE_TOPIC = "/joint_states"


def read_log(source: Path, out: Path | None, given: Mapping[str, Any]) -> Recording | Model:
    """Read a log with the ``given`` options, and write ``out``: ``exchange.import_log``."""
    lists = {name: [given[name]] for name in LISTS if isinstance(given.get(name), str)}
    given = {**given, **lists}
    if out is not None:
        check_writable(out)
    if source.suffix == ".json" and source.is_file() and is_bam_parameters(read_json(source)):
        return _parameters(source, out, given)
    _check_out(source, out, ".csv")
    recording = _recording(source, given)
    loads = loads_of(given.get("inertia"), given.get("pendulum"), recording.joints)
    recording = replace(recording, loads={**recording.loads, **loads})
    measured_at = recording.t[np.isfinite(recording.position).any(axis=1)]
    check_sampling(source, measured_at, where="times")
    if out is not None:
        write_recording(recording, out)
    return recording


def _parameters(source: Path, out: Path | None, given: Mapping[str, Any]) -> Model:
    """Parameters that BAM identified, as a model."""
    _refuse_others(source, "BAM's parameters", given)
    loads = loads_of(given.get("inertia"), given.get("pendulum"), ["j1"])
    if not loads:
        expected = "the load of the servo, which parameters of BAM do not state"
        raise InputError(source, "", "no --inertia or --pendulum j1=...", expected)
    _check_out(source, out, ".json")
    model = read_bam_parameters(source, loads["j1"])
    if out is not None:
        write_model(model, out)
    return model


def _check_out(source: Path, out: Path | None, ending: str) -> None:
    """Raise InputError unless a result has this ending and does not replace the log."""
    if out is None:
        return
    if out.suffix != ending:
        raise InputError(out, "", f"the ending {out.suffix!r}", f"a file name ending in {ending}")
    if source.resolve() in (out.resolve(), out.with_suffix(".json").resolve()):
        raise InputError(out, "", "a name that would overwrite the log", "another name")


def _recording(source: Path, given: Mapping[str, Any]) -> Recording:
    """The recording in a log, with the loads that the log states."""
    joints = given.get("joints")
    if source.suffix == ".json" and not source.is_dir():
        _refuse_others(source, "a BAM log", given)
        return read_bam(source)
    if not source.exists():
        raise InputError(source, "", "no such file", KINDS)
    if is_lerobot(source):
        _refuse_others(source, "a LeRobot dataset", given)
        episode = given.get("episode")
        return read_lerobot(source, _units(source, given), episode=episode, joints=joints)
    if source.suffix in TABLES:
        _refuse_others(source, "a table", given)
        columns, unit = given.get("columns"), given.get("time_unit")
        lacking = [] if columns else [f"--columns {MAP}"]
        lacking += [] if unit else [f"--time-unit {'|'.join(SECONDS_PER)}"]
        units = _units(source, given, lacking)
        return read_table(source, column_map(columns), units, time_unit=unit)
    if not source.is_dir() and source.suffix not in BAGS:
        raise InputError(source, "", f"the ending {source.suffix!r}", KINDS)
    _refuse_others(source, "a ROS bag", given)
    sent, measured = given.get("command_topic"), given.get("state_topic") or STATE_TOPIC
    ask_for(source, [] if sent else ["--command-topic TOPIC (of the set-points)"])
    return read_bag(source, state_topic=measured, command_topic=sent or (), joints=joints)


def _refuse_others(source: Path, kind: str, given: Mapping[str, Any]) -> None:
    """Refuse options that belong to another kind of log."""
    known = {name for names in OPTIONS.values() for name in names} - set(OPTIONS[kind])
    others = [name for name in given if name in known]
    refuse(source, _flags(others), kind, _flags(OPTIONS[kind]))


def _flags(names: Iterable[str]) -> list[str]:
    return [f"--{name.replace('_', '-')}" for name in names]


def _units(source: Path, given: Mapping[str, Any], lacking: Sequence[str] = ()) -> Conversion:
    return conversion(*map(given.get, ANGLES), source=source, lacking=lacking)
