"""The library of servos as a table, as text, as a row in Markdown and as a plot."""

from collections.abc import Mapping, Sequence

import numpy as np

from sim2real.display import Drawing
from sim2real.report.drawing import ACCENT, INK, new_figure
from sim2real.report.page import Note, Section, Table, printable
from sim2real.report.quantity import milliradians
from sim2real.servo_library.catalogue import ServoEntry

COLUMNS = ("name", "servo", "supply", "gain", "load", "held out", "date", "origin")
_HELD_OUT = "held out: RMS error on trajectories that no fit used, where it was measured"


def cells(entry: ServoEntry) -> tuple[str, ...]:
    """The cells of a servo's row."""
    load = entry.joint.load
    weight = "unknown" if load is None else f"{load.inertia_kgm2:.3g} kg m²"
    if load is not None and load.pendulum_mass_kg > 0:
        weight = f"{load.pendulum_mass_kg:.3g} kg at {load.pendulum_length_m:g} m"
    return (
        entry.name,
        entry.type,
        "-" if entry.supply_V is None else f"{entry.supply_V:g} V",
        "-" if entry.firmware_gain is None else f"{entry.firmware_gain:g}",
        weight,
        milliradians(entry.held_out_rad),
        entry.date,
        entry.origin,
    )


def servos_section(entries: Sequence[ServoEntry]) -> Section:
    """A row for each servo."""
    return Section("Servos", "", [Table(COLUMNS, [*map(cells, entries)]), Note("info", _HELD_OUT)])


def markdown_row(entry: ServoEntry) -> str:
    """The row of a servo in a Markdown table, with its licence and source."""
    row = (*cells(entry), entry.licence, entry.source)
    return f"| {' | '.join(map(printable, row))} |"


def motor_figure(entries: Sequence[ServoEntry]) -> Drawing:
    """Stall torque and no-load speed of servos with a known line; those identified are marked."""
    speed = "no_load_speed_rad_s"
    lines = [x for x in entries if not x.joint.per_inertia and x.joint.motor.get(speed)]
    torques = [stall_torque(entry.joint.motor) for entry in lines]
    speeds = [entry.joint.motor[speed] for entry in lines]
    colors = [ACCENT if entry.origin == "identified" else INK for entry in lines]
    title = "Stall torque and no-load speed of each servo"
    with new_figure(90 + 26 * max(1, len(lines)), title) as figure:
        panels = figure.subplots(1, 2, sharey=True)
        for axes, values in zip(panels, (torques, speeds), strict=True):
            axes.scatter(values, range(len(lines)), color=colors, s=26)
        panels[0].set(xscale="log", ylim=(len(lines) - 0.5, -0.5))
        panels[0].set_title("stall torque, N m")
        panels[0].xaxis.set_major_formatter("{x:g}")
        panels[0].margins(x=0.1)
        panels[0].set_yticks(range(len(lines)), [entry.name for entry in lines])
        panels[1].set_title("no-load speed, rad/s")
        panels[1].set_xlim(0.0, 1.1 * max(speeds, default=1.0))
    return figure


def stall_torque(motor: Mapping[str, float]) -> float:
    """Torque at standstill and full drive in N m, with the rise of the resistance."""
    rise = motor.get("resistance_rise", 0.0)
    return float(motor["stall_torque_Nm"] / (0.5 + np.sqrt(0.25 + rise)))
