"""Designed recordings as sections and figures: what they tell of parameters, or of rival sets."""

import numpy as np

from sim2real.arrays import Array
from sim2real.design.plan import Design, JointDesign, NextRecording
from sim2real.design.rivals import JointForecast, RivalDesign
from sim2real.diagnose.rival_sets import task
from sim2real.display import Drawing
from sim2real.report.page import Block, Note, Section, Table, Text
from sim2real.report.series import Panel, series_block, series_figure
from sim2real.units import readable_name, three_digits
from sim2real.viewers.scenes import COMMAND, SignalGroup

_CAPTION = (
    "Command and expected motion; half-width of the 90 % interval of each parameter if the "
    "recording ended there, in percent of its value."
)
_RIVALS_LEAD = (
    "A recording to make next, with the commands that leave the least expected uncertainty over "
    "the sets of effects that the diagnosis left open."
)
_RIVALS_CAPTION = "The set-points of {joint}, of the body those of all joints."
_PART_S = 0.5
_LISTED = 10


def design_section(design: Design, *, plots: bool = True) -> Section:
    """Expected half-width of the interval of each parameter, and the commands, by joint."""
    blocks: list[Block] = []
    for name, joint in design.joints.items():
        limits = joint.information.limits
        held = limits.largest_held_rad
        within = f", within {held:.2g} rad of hanging, where its servo can hold the load"
        lead = (
            f"Commands of {len(design.t) * limits.period_s:.0f} s that are expected to "
            f"determine {name} best, from what its {joint.origin} says"
            f"{within if np.isfinite(held) else ''}; {joint.found.evaluated} commands were "
            "compared. Intervals are those of 'identify' on this recording alone, relative to the "
            "parameter."
        )
        rows = []
        for parameter, width in joint.expected.items():
            determined = "yes" if joint.determined[parameter] else "not determined"
            half = f"± {three_digits(100 * width)} %"
            rows.append((readable_name(parameter), half, determined))
        header = ("parameter", "expected 90 % interval", "determined")
        blocks += [Text(lead, heading=name), Table(header, rows)]
        if plots:
            label = f"{name}: designed command"
            blocks.append(series_block(_panels(design.t, name, joint), label, _CAPTION))
    return Section("Next recording", "", blocks)


def _panels(t: Array, name: str, joint: JointDesign) -> list[Panel]:
    angle, _ = joint.information.sensitivities(joint.found.command[None])
    motion = {COMMAND: joint.found.command, "expected": angle[0, 0]}
    parts = max(round(float(t[-1]) / _PART_S), 1)
    ends = np.linspace(0.0, float(t[-1]), parts + 1)[1:]
    names = map(readable_name, joint.information.prior.names)
    widths = dict(zip(names, 100 * joint.over_time(parts).T, strict=True))
    position = SignalGroup((name, "position"), "rad", t, motion)
    interval = SignalGroup((name, "interval"), "%", ends, widths)
    return [
        Panel(position, "command and motion, rad"),
        Panel(interval, "half-width of the 90 % interval, %", log=True),
    ]


def rivals_section(design: RivalDesign) -> Section:
    """Text, tables and plots of a recording that tells rivals apart."""
    blocks: list[Block] = [Note("info", str(design))]
    for joint in design.joints:
        name = joint.rivals.component
        before, after = (np.exp(x) for x in (joint.entropy, joint.remaining))
        text = (
            f"{len(joint.rivals.sets)} sets of effects are open, as uncertain as {before:.1f} "
            f"equally probable ones. After the recording {after:.1f} are expected to remain."
        )
        rows = [
            (task(pair.first, pair.second), f"{pair.distance:.2g}", f"{pair.expected:.2f}")
            for pair in joint.pairs[:_LISTED]
        ]
        blocks += [
            Text(text, heading=f"What {name} will tell"),
            series_block(_commands(joint), name, _RIVALS_CAPTION.format(joint=name)),
            Table(["to", "distance", "expected"], rows),
        ]
    return Section("Next recording", _RIVALS_LEAD, blocks)


def design_figure(design: NextRecording, name: str | None = None) -> Drawing:
    """Plot the command of a joint, by default the first, and what it tells over time."""
    if isinstance(design, RivalDesign):
        by_name = {one.rivals.component: one for one in design.joints}
        name = name or next(iter(by_name))
        return series_figure(_commands(by_name[name]), f"{name}: commands")
    assert isinstance(design, Design)
    name = name or next(iter(design.joints))
    return series_figure(_panels(design.t, name, design.joints[name]), f"{name}: designed command")


def _commands(joint: JointForecast) -> list[Panel]:
    columns = joint.command.reshape(joint.times.size, -1).T
    names = [COMMAND] if len(columns) == 1 else [f"{COMMAND} {k + 1}" for k in range(len(columns))]
    commands = dict(zip(names, columns, strict=True))
    group = SignalGroup((joint.rivals.component,), "rad", joint.times, commands)
    return [Panel(group, "command, rad")]
