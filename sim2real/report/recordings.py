"""Recordings section of a report: clock, noise, motion, and what can be identified."""

from __future__ import annotations

from collections.abc import Sequence

from sim2real.check import Check
from sim2real.recording import Recording
from sim2real.report.drawing import svg
from sim2real.report.page import Block, Figure, Note, Section, Table, Text
from sim2real.report.style import NARROW
from sim2real.report.timing_plot import timing_figure

_LEAD = (
    "Check before the fit: regularity of the clock, noise, motion of every joint, and the accuracy "
    "with which a servo could be identified at best."
)
_CLOCKS = "Each recording and its clock."
_JOINTS = (
    "Each joint of {recording}: ranges of command and position, noise and resolution of its "
    "sensor, and what a fit can be expected to identify (half-widths of 90 % intervals)."
)
_TIMING = "Clock of {recording}: the time from each sample to the next, and its histogram."


def recordings_section(recordings: Sequence[Recording], checks: Sequence[Check]) -> Section:
    """Results of ``check``: tables, notes and a figure of the first recording's clock.

    Args:
        recordings: The recordings.
        checks: The check of each, in the same order.
    """
    blocks: list[Block] = [_clock_table(checks)]
    figure = timing_figure(recordings[0])
    caption = _TIMING.format(recording=recordings[0].name)
    blocks.append(Figure(svg(figure), caption, svg(figure, width=NARROW)))
    blocks += [_joint_table(check) for check in checks[:1]]
    blocks += _notes(checks)
    return Section("Recordings", _LEAD, blocks)


def _clock_table(checks: Sequence[Check]) -> Table:
    rows = [
        (
            check.recording,
            f"{check.duration_s:.1f}",
            f"{check.timing.rate_hz:.1f}",
            f"{1e3 * check.timing.jitter_s:.2f}",
            f"{sum(length for _, length in check.timing.gaps):.2f}",
            str(check.timing.missing_cells),
        )
        for check in checks
    ]
    header = ("recording", "length\ns", "rate\nHz", "jitter\nms", "gaps\ns", "cells\nmissing")
    return Table(header, rows, _CLOCKS)


def _joint_table(check: Check) -> Table:
    rows = [
        (
            joint.joint,
            f"{joint.command_range_rad:.2f}",
            f"{joint.range_rad:.2f}",
            f"{1e3 * joint.noise_rad:.2f}",
            f"{1e3 * joint.step_rad:.2f}" if joint.step_rad else "none",
            "; ".join(joint.identifiable),
        )
        for joint in check.joints
    ]
    header = ("joint", "command\nrad", "position\nrad", "noise\nmrad", "step\nmrad", "a fit")
    return Table(header, rows, _JOINTS.format(recording=check.recording))


def _notes(checks: Sequence[Check]) -> list[Block]:
    """Distinct findings, each with the recordings that share it."""
    where: dict[str, list[str]] = {}
    for check in checks:
        for finding in check.all_findings:
            where.setdefault(finding.text, []).append(check.recording)
    if not where:
        return [Note("good", "No irregularities were found.")]
    heading = Text("Remarks of the check.", heading="Remarks")
    everywhere = len(checks)
    return [
        heading,
        *(
            Note("info", finding if len(names) == everywhere else f"{', '.join(names)}: {finding}")
            for finding, names in where.items()
        ),
    ]
