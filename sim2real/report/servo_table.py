"""The library of servos as text, as a table in Markdown and as a plot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from sim2real.report.quantity import milliradians, printable
from sim2real.report.style import ACCENT, INK, house_style, new_figure
from sim2real.report.table import fit_report
from sim2real.servo_library.entry import ServoEntry

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMNS = ("name", "servo", "supply", "gain", "load", "held out", "date", "origin")
NONE = "-"


def cells(entry: ServoEntry) -> tuple[str, ...]:
    """The cells of a servo's row."""
    gain = NONE if entry.firmware_gain is None else f"{entry.firmware_gain:g}"
    supply = NONE if entry.supply_V is None else f"{entry.supply_V:g} V"
    return (
        entry.name,
        entry.type,
        supply,
        gain,
        load_text(entry),
        milliradians(entry.held_out_rad),
        entry.date,
        entry.origin,
    )


def load_text(entry: ServoEntry) -> str:
    """The load that a servo was identified with."""
    load = entry.joint.load
    if load is None:
        return "unknown"
    if load.pendulum_mass_kg > 0:
        return f"{load.pendulum_mass_kg:.3g} kg at {load.pendulum_length_m:g} m"
    return f"{load.inertia_kgm2:.3g} kg m²"


def table_of(entries: Sequence[ServoEntry]) -> str:
    """One line per servo."""
    rows = [COLUMNS, *map(cells, entries)]
    widths = [max(len(row[k]) for row in rows) for k in range(len(COLUMNS))]
    lines = ["  ".join(f"{x:<{w}}" for x, w in zip(row, widths, strict=True)) for row in rows]
    text = "\n".join(printable(line.rstrip()) for line in lines)
    return f"{text}\n\nheld out: RMS error on trajectories that no fit used, where it was measured"


def markdown_row(entry: ServoEntry) -> str:
    """The row of a servo in a Markdown table, with its licence and source."""
    return (
        "| " + " | ".join(printable(x) for x in (*cells(entry), entry.licence, entry.source)) + " |"
    )


def markdown_table(entries: Sequence[ServoEntry]) -> str:
    """The servos as a Markdown table."""
    header = "| " + " | ".join((*COLUMNS, "licence", "source")) + " |"
    rule = "| " + " | ".join("---" for _ in (*COLUMNS, "licence", "source")) + " |"
    return "\n".join([header, rule, *map(markdown_row, entries)])


def entry_report(entry: ServoEntry) -> str:
    """What a servo is, where it comes from, and its parameters with intervals."""
    facts = dict(zip(COLUMNS, cells(entry), strict=True))
    facts |= {"licence": entry.licence, "source": entry.source}
    if entry.scored_on:
        facts["held out"] += f", {entry.scored_on}"
    width = max(map(len, facts))
    lines = [f"{name:<{width}}  {text}" for name, text in facts.items()]
    return "\n".join(map(printable, lines)) + f"\n\n{fit_report(entry.model)}"


def motor_figure(entries: Sequence[ServoEntry]) -> Figure:
    """Stall torque and no-load speed of each servo, the ends of its torque-speed line.

    Servos whose line is not known, or only per unit of inertia, are left out.
    """
    with house_style():
        figure = new_figure(360, "Stall torque and no-load speed of each servo")
        axes = figure.subplots()
        lines = [
            e for e in entries if not e.joint.per_inertia and "no_load_speed_rad_s" in e.joint.motor
        ]
        lines.sort(key=lambda entry: entry.joint.motor["no_load_speed_rad_s"])
        for number, entry in enumerate(lines):
            motor = entry.joint.motor
            point = stall_torque(motor), motor["no_load_speed_rad_s"]
            color = ACCENT if entry.origin == "identified" else INK
            axes.plot(*point, "o", color=color, markersize=5, markeredgewidth=0)
            axes.annotate(
                entry.name,
                point,
                xytext=(0, 9 if number % 2 else -9),  # neighbours are labelled above and below
                textcoords="offset points",
                ha="center",
                va="center",
                color=color,
                size=10,
            )
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter("{x:g}")
        axes.margins(x=0.2, y=0.15)
        axes.set_xlabel("stall torque, N m")
        axes.set_ylabel("no-load speed, rad/s")
    return figure


def stall_torque(motor: Mapping[str, float]) -> float:
    """Torque at standstill and full drive in N m, with the rise of the resistance."""
    rise = motor.get("resistance_rise", 0.0)
    return float(motor["stall_torque_Nm"] / (0.5 + np.sqrt(0.25 + rise)))
