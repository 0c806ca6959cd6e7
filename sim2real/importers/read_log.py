"""Logs of all tools: which kind a log is, which options it takes, and its reader."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sim2real.clock import check_sampling
from sim2real.errors import InputError
from sim2real.importers.bam import is_bam_parameters, read_bam, read_bam_parameters
from sim2real.importers.lerobot import is_lerobot, read_lerobot
from sim2real.importers.options import MAP, SECONDS_PER, ask_for, conversion, loads_of, refuse
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
PARAMETERS = "BAM's parameters"
OPTIONS = {
    "a BAM log": LOADS,
    PARAMETERS: LOADS,
    "a ROS bag": ("state_topic", "command_topic", "joints", *LOADS),
    "a LeRobot dataset": (*ANGLES, "episode", "joints", *LOADS),
    "a table": ("columns", "time_unit", *ANGLES, *LOADS),
}
"""Options of each kind of log."""
LISTS = ("command_topic", "joints", "units", "columns", *LOADS)
"""Options with several values; one value may be a text."""


def read_log(source: Path, out: Path | None, given: Mapping[str, Any]) -> Recording | Model:
    """Read a log with the ``given`` options, and write ``out``: ``exchange.import_log``."""
    given = {n: [x] if n in LISTS and isinstance(x, str) else x for n, x in given.items()}
    if out is not None:
        check_writable(out)
    kind = _kind(source)
    refuse(source, [name for name in given if name not in OPTIONS[kind]], kind, OPTIONS[kind])
    ending = ".json" if kind == PARAMETERS else ".csv"
    if out is not None and out.suffix != ending:
        raise InputError(out, "", f"the ending {out.suffix!r}", f"a file name ending in {ending}")
    if out is not None and source.resolve() in (out.resolve(), out.with_suffix(".json").resolve()):
        raise InputError(out, "", "a name that would overwrite the log", "another name")
    load = given.get("inertia"), given.get("pendulum")
    if kind == PARAMETERS:
        if not any(load):
            expected = "the load of the servo, which parameters of BAM do not state"
            raise InputError(source, "", "no --inertia or --pendulum j1=...", expected)
        model = read_bam_parameters(source, loads_of(*load, ["j1"])["j1"])
        if out is not None:
            write_model(model, out)
        return model
    recording = _recording(source, kind, given)
    loads = loads_of(*load, recording.joints)
    recording = replace(recording, loads={**recording.loads, **loads})
    measured_at = recording.t[np.isfinite(recording.position).any(axis=1)]
    check_sampling(source, measured_at, where="times")
    if out is not None:
        write_recording(recording, out)
    return recording


def _kind(source: Path) -> str:
    """The kind of a log, of ``OPTIONS``."""
    if source.suffix == ".json" and not source.is_dir():
        parameters = source.is_file() and is_bam_parameters(read_json(source))
        return PARAMETERS if parameters else "a BAM log"
    if not source.exists():
        raise InputError(source, "", "no such file", KINDS)
    if is_lerobot(source):
        return "a LeRobot dataset"
    if source.suffix in TABLES:
        return "a table"
    if not source.is_dir() and source.suffix not in BAGS:
        raise InputError(source, "", f"the ending {source.suffix!r}", KINDS)
    return "a ROS bag"


def _recording(source: Path, kind: str, given: Mapping[str, Any]) -> Recording:
    """The recording in a log, with the loads that the log states."""
    joints = given.get("joints")
    if kind == "a BAM log":
        return read_bam(source)
    if kind == "a ROS bag":
        sent, measured = given.get("command_topic"), given.get("state_topic", "/joint_states")
        ask_for(source, [] if sent else ["--command-topic TOPIC (of the set-points)"])
        return read_bag(source, state_topic=measured, command_topic=sent or (), joints=joints)
    table, lacking = kind == "a table", []
    if table and not given.get("columns"):
        lacking.append(f"--columns {MAP}")
    if table and not given.get("time_unit"):
        lacking.append(f"--time-unit {'|'.join(SECONDS_PER)}")
    units = conversion(*map(given.get, ANGLES), source=source, lacking=lacking)
    if table:
        columns = column_map(given["columns"])
        return read_table(source, columns, units, time_unit=given["time_unit"])
    return read_lerobot(source, units, episode=given.get("episode"), joints=joints)
