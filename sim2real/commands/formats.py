"""Files of other tools: ``import``, ``robot``, ``export-servo`` and ``export-ranges``."""

import argparse
import tomllib

from sim2real import exchange
from sim2real.commands.command import arguments_of
from sim2real.errors import InputError
from sim2real.findings import all_findings
from sim2real.importers.urdf import read_urdf, robot_toml
from sim2real.model import Model, read_model
from sim2real.output import check_writable, write_whole
from sim2real.ranges.entry import Ranges, read_ranges
from sim2real.recording import Recording

_UNKNOWN_LOAD = (
    "load unknown of {joints}: identify will fit kp and kd per unit of inertia (1/s2, 1/s), not in "
    "N m; to state the load, import again with --inertia {joint}=KGM2 (the load without the "
    "servo's rotor) or --pendulum {joint}=MASS_KG,LENGTH_M"
)


def import_log(options: argparse.Namespace) -> int:
    """Import one log; print a summary, and a remark on joints with unknown loads."""
    found = exchange.import_log(**arguments_of(exchange.import_log, options))
    if isinstance(found, Model):
        settings = found.provenance["servo"]
        about = f"gain {settings['firmware_gain']:g}, supply {settings['supply_V']:g} V"
        notes = [f"  {note}" for note in found.joints["j1"].notes]
    else:
        about = _summary(found)
        notes = [f"! {warning}" for warning in found.metadata.get("import_warnings", ())]
        findings = [one for one in all_findings(found) if one.severity != "note"]
        notes += [f"! {finding.severity}: {finding.text}" for finding in findings]
        if unknown := [joint for joint in found.joints if joint not in found.loads]:
            notes.append(_UNKNOWN_LOAD.format(joints=", ".join(unknown), joint=unknown[0]))
    print("\n".join([f"{options.out}: {about}", *notes]))
    return 0


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
        print("\n".join(f"  {line}" for line in lines))
    return 0


def export_servo(options: argparse.Namespace) -> int:
    """Write the model's actuators for another simulator, refitted without effects that it lacks."""
    return _exported(read_model(options.model), options)


def export_ranges(options: argparse.Namespace) -> int:
    """Write the ranges for another simulator; print what it does not express."""
    return _exported(read_ranges(options.ranges), options)


def _exported(source: Model | Ranges, options: argparse.Namespace) -> int:
    """Write; print what the text lacks, the errors of refits, and differences of the simulator."""
    export = exchange.export(**arguments_of(exchange.export, options, source=source))
    errors = {name: [vars(one) for one in rows] for name, rows in export.errors.items()}
    left_out = [*map(str, export.left_out)]
    options.result = {"file": str(options.out), "not_expressed": left_out, **errors}
    print(f"{', '.join(map(str, export.files(options.out)))}: for {options.to}")
    if costs := str(export):
        print(costs)
    return 0
