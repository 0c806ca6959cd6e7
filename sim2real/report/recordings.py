"""Recordings and their checks: clock, noise, motion, and what can be identified."""

from collections.abc import Sequence

import numpy as np

from sim2real.arrays import Array
from sim2real.check import Check
from sim2real.recording import Recording
from sim2real.report.page import Block, Note, Section, Table, Text
from sim2real.report.series import series_block, timing_panel

_LEAD = (
    "Check before the fit: regularity of the clock, noise, motion of every joint, and the accuracy "
    "with which a servo could be identified at best."
)
_TIMING = "Clock of {recording}: the time from each sample to the next."


def recording_section(recording: Recording) -> Section:
    """The summary of a recording, and a row for each joint."""
    rows = []
    for j, joint in enumerate(recording.joints):
        spans = (_span(angles[:, j]) for angles in (recording.command, recording.position))
        rows.append((joint, *spans, str(recording.missing(j))))
    blocks: list[Block] = [Table(("joint", "command", "position", "missing samples"), rows)]
    if recording.columns:
        blocks.append(Note("info", f"Further columns: {', '.join(recording.columns)}"))
    return Section(f"Recording {recording.name}", recording.summary, blocks)


def check_section(check: Check) -> Section:
    """Clock, motion of the joints, and findings."""
    clock, joints = check.timing, len(check.joints)
    pauses = "no gap" if not clock.gaps else f"{sum(g[1] for g in clock.gaps):.3g} s in gaps"
    lead = (
        f"{check.kind}, {check.duration_s:.2f} s, {joints} joint{'s' if joints != 1 else ''}; "
        f"clock: {clock.rate_hz:.4g} Hz, jitter {1e3 * clock.jitter_s:.2g} ms, {pauses}, "
        f"{clock.missing_cells} positions missing"
    )
    rows = []
    for x in check.joints:
        ranges = f"{x.command_range_rad:.3f}", f"{x.range_rad:.3f}"
        step = f"{1e3 * x.step_rad:.2f}" if x.step_rad else "–"
        sensor = f"{1e3 * x.noise_rad:.2f}", step, str(x.missing)
        rows.append((x.joint, str(x.moves), *ranges, *sensor, x.load))
    header = (
        "joint", "moves", "command\nrad", "position\nrad", "noise\nmrad", "step\nmrad", "missing",
        "load",
    )  # fmt: skip
    notes = [
        Note("warn", x.text if x.severity == "note" else f"{x.severity}: {x.text}")
        for x in check.all_findings
    ]
    notes += [Note("info", f"{row.joint}: {x}") for row in check.joints for x in row.identifiable]
    return Section(f"Check of {check.recording}", lead, [Table(header, rows), *notes])


def recordings_section(recordings: Sequence[Recording], checks: Sequence[Check]) -> Section:
    """The check of each recording, and the clock of the first."""
    caption = _TIMING.format(recording=recordings[0].name)
    blocks: list[Block] = [series_block([timing_panel(recordings[0])], "clock", caption)]
    for number, section in enumerate(map(check_section, checks)):
        blocks.append(Text(section.lead, heading=checks[number].recording))
        if number == 0 or checks[number].all_findings:
            blocks += section.blocks
    return Section("Recordings", _LEAD, blocks)


def _span(angles: Array) -> str:
    """Smallest to largest of the angles that are not missing, in rad."""
    finite = angles[np.isfinite(angles)]
    return f"{finite.min():.3f} to {finite.max():.3f} rad" if finite.size else "none"
