"""``sim2real import``: a log becomes a recording, BAM's parameters a model.

Also ``sim2real robot``: a URDF becomes a robot.
"""

from __future__ import annotations

import argparse
import sys
import tomllib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from sim2real.clock import check_sampling
from sim2real.errors import InputError
from sim2real.findings import all_findings
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
from sim2real.importers.urdf import read_urdf, robot_toml
from sim2real.model import write_model
from sim2real.output import check_writable, write_whole
from sim2real.recording import Recording, write_recording
from sim2real.structured import read_json

BAGS = (".bag", ".db3", ".mcap")
TABLES = (".csv", ".tsv")
KINDS = f"a BAM log (.json), a ROS bag (a folder, {', '.join(BAGS)}), a LeRobot dataset (a folder "
KINDS += f"with meta/info.json) or a table ({', '.join(TABLES)})"
LOADS = ("inertia", "pendulum")
ANGLES = ("units", "counts_per_turn", "zero_count", "calibration")
OPTIONS = {
    "a BAM log": LOADS,
    "BAM's parameters": LOADS,
    "a ROS bag": ("state_topic", "command_topic", "joints", *LOADS),
    "a LeRobot dataset": (*ANGLES, "episode", "joints", *LOADS),
    "a table": ("columns", "time_unit", *ANGLES, *LOADS),
}
"""Options of each kind of log."""
STATE_TOPIC = "/joint_states"
_UNKNOWN_LOAD = (
    "load unknown of {joints}: identify will fit kp and kd per unit of inertia (1/s2, 1/s), not in "
    "N m; to state the load, import again with --inertia {joint}=KGM2 (the load without the "
    "servo's rotor) or --pendulum {joint}=MASS_KG,LENGTH_M"
)


def run(args: argparse.Namespace) -> int:
    """Import one log; print a summary, and a remark on joints with unknown loads."""
    source, out = Path(args.source), check_writable(args.out)
    if source.suffix == ".json" and source.is_file() and is_bam_parameters(read_json(source)):
        _refuse_others(source, "BAM's parameters", args)
        return _import_parameters(source, out, args)
    if out.suffix != ".csv":
        raise InputError(out, "", f"the ending {out.suffix!r}", "a file name ending in .csv")
    if source.resolve() in (out.resolve(), out.with_suffix(".json").resolve()):
        raise InputError(out, "", "a name that would overwrite the log", "another name")
    recording = _read(source, args)
    loads = loads_of(args.inertia, args.pendulum, recording.joints)
    recording = replace(recording, loads={**recording.loads, **loads})
    measured_at = recording.t[np.isfinite(recording.position).any(axis=1)]
    check_sampling(source, measured_at, where="times")
    write_recording(recording, out)
    print(f"{out}: {_summary(recording)}")
    for warning in recording.metadata.get("import_warnings", ()):
        print(f"! {warning}")
    for finding in all_findings(recording):
        if finding.severity != "note":
            print(f"! {finding.severity}: {finding.text}")
    if unknown := [joint for joint in recording.joints if joint not in recording.loads]:
        print(_UNKNOWN_LOAD.format(joints=", ".join(unknown), joint=unknown[0]))
    return 0


def _import_parameters(source: Path, out: Path, args: argparse.Namespace) -> int:
    """Import parameters that BAM identified as a model; print what it does not express."""
    loads = loads_of(args.inertia, args.pendulum, ["j1"])
    if not loads:
        expected = "the load of the servo, which parameters of BAM do not state"
        raise InputError(source, "", "no --inertia or --pendulum j1=...", expected)
    if out.suffix != ".json":
        raise InputError(out, "", f"the ending {out.suffix!r}", "a model, a name ending in .json")
    if source.resolve() == out.resolve():
        raise InputError(out, "", "a name that would overwrite the parameters", "another name")
    model = read_bam_parameters(source, loads["j1"])
    write_model(model, out)
    settings = model.provenance["servo"]
    print(f"{out}: gain {settings['firmware_gain']:g}, supply {settings['supply_V']:g} V")
    for note in model.joints["j1"].notes:
        print(f"  {note}")
    return 0


def _read(source: Path, args: argparse.Namespace) -> Recording:
    if source.suffix == ".json" and not source.is_dir():
        _refuse_others(source, "a BAM log", args)
        return read_bam(source)
    if not source.exists():
        raise InputError(source, "", "no such file", KINDS)
    if is_lerobot(source):
        _refuse_others(source, "a LeRobot dataset", args)
        return read_lerobot(source, _units(source, args), episode=args.episode, joints=args.joints)
    if source.suffix in TABLES:
        _refuse_others(source, "a table", args)
        lacking = [] if args.columns else [f"--columns {MAP}"]
        lacking += [] if args.time_unit else [f"--time-unit {'|'.join(SECONDS_PER)}"]
        units = _units(source, args, lacking)
        return read_table(source, column_map(args.columns), units, time_unit=args.time_unit)
    if not source.is_dir() and source.suffix not in BAGS:
        raise InputError(source, "", f"the ending {source.suffix!r}", KINDS)
    _refuse_others(source, "a ROS bag", args)
    ask_for(source, [] if args.command_topic else ["--command-topic TOPIC (of the set-points)"])
    state_topic = args.state_topic or STATE_TOPIC
    return read_bag(
        source, state_topic=state_topic, command_topic=args.command_topic, joints=args.joints
    )


def _refuse_others(source: Path, kind: str, args: argparse.Namespace) -> None:
    """Refuse options that belong to another kind of log."""
    known = {name for names in OPTIONS.values() for name in names} - set(OPTIONS[kind])
    given = [name for name in vars(args) if name in known and getattr(args, name) is not None]
    refuse(source, _flags(given), kind, _flags(OPTIONS[kind]))


def _flags(names: Sequence[str]) -> list[str]:
    return [f"--{name.replace('_', '-')}" for name in names]


def _units(source: Path, args: argparse.Namespace, lacking: Sequence[str] = ()) -> Conversion:
    values = (args.units, args.counts_per_turn, args.zero_count, args.calibration)
    return conversion(*values, source=source, lacking=lacking)


def _summary(recording: Recording) -> str:
    loaded = [joint for joint in recording.joints if joint in recording.loads]
    loads = f"load known on {', '.join(loaded)}" if loaded else "loads unknown"
    parts = [f"{recording.t.size} rows in {recording.duration_s:.2f} s"]
    parts.append(f"joints {', '.join(recording.joints)}")
    parts += [f"{recording.rate_hz:.3g} samples a second", loads]
    parts += [str(recording.metadata["format"])] if "format" in recording.metadata else []
    if (out := recording.metadata.get("left_out")) is not None:
        parts.append(f"{out['rows']} rows omitted from {out['from_s']:g} s: {out['why']}")
    return "; ".join(parts)


def robot(options: argparse.Namespace) -> int:
    """Write a robot file; print the fields to be filled in, which the file lists too."""
    out = check_writable(options.out)
    text, notes = robot_toml(read_urdf(options.source), options.joints)
    head = f"# From {' '.join(options.source.name.splitlines())}."
    lines = [" ".join(note.splitlines()) for note in notes]
    text = "\n".join([head, *(f"# not here: {line}" for line in lines), text])
    try:
        tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        found, expected = (
            f"names that TOML can't hold ({error})",
            "names without control characters",
        )
        raise InputError(options.source, "", found, expected) from None
    write_whole(out, text)
    options.result = {"file": str(out), "not_in_it": lines}
    print(out)
    if lines:
        print("not in it, to be filled in where a command asks for it:")
        sys.stdout.writelines(f"  {line}\n" for line in lines)
    return 0
