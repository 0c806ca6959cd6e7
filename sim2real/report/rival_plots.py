"""Section of a page: a designed recording, and which rival sets of effects it tells apart."""

from __future__ import annotations

from itertools import cycle
from typing import TYPE_CHECKING

import numpy as np

from sim2real.design.tell_apart import JointForecast, RivalDesign
from sim2real.diagnose.rival_sets import task
from sim2real.report.diagnosis_what import figure
from sim2real.report.page import Block, Note, Section, Table, Text
from sim2real.report.quantity import printable
from sim2real.report.series import drawable
from sim2real.report.style import ACCENT, FAINT, INK, house_style, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LEAD = (
    "A recording to make next, with the commands that leave the least expected uncertainty over "
    "the sets of effects that the diagnosis left open."
)
_CAPTION = "The set-points of {joint}, of the body those of all joints."
_SHOWN = 10


def rivals_figure(joint: JointForecast) -> Figure:
    """Plot the commands."""
    t = np.asarray(joint.rivals.period_s * np.arange(len(joint.command), dtype=np.float64))
    with house_style():
        figure = new_figure(200, printable(f"{joint.rivals.component}: commands"))
        axes = figure.subplots()
        signals = joint.command.reshape(t.size, -1).T
        for signal, colour in zip(signals, cycle((INK, ACCENT, FAINT)), strict=False):
            axes.plot(*drawable(t, signal), color=colour, drawstyle="steps-post")
        axes.set_title("set-point, rad")
        axes.set_xlabel("time, s")
    return figure


def rivals_section(design: RivalDesign) -> Section:
    """Text, tables and figures of a recording that tells rivals apart."""
    blocks: list[Block] = [Note("info", str(design))]
    for joint in design.joints:
        name = joint.rivals.component
        drawing = rivals_figure(joint)
        blocks.append(Text(_entropy(joint), heading=f"What {name} will tell"))
        blocks.append(figure(drawing, _CAPTION.format(joint=name)))
        rows = [
            [task(pair.first, pair.second), f"{pair.distance:.2g}", f"{pair.expected:.2f}"]
            for pair in joint.pairs[:_SHOWN]
        ]
        blocks.append(Table(["to", "distance", "expected"], rows))
    return Section("Next recording", _LEAD, blocks)


def _entropy(joint: JointForecast) -> str:
    before, after = (np.exp(x) for x in (joint.entropy, joint.remaining))
    return (
        f"{len(joint.rivals.sets)} sets of effects are open, as uncertain as {before:.1f} equally "
        f"probable ones. After the recording {after:.1f} are expected to remain."
    )
