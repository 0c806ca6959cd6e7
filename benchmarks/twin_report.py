"""The table and the picture of ``twin_fit.py``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from sim.robot.swimmer import CONTROL_S
from sim2real.arrays import Array

BAR = 0.15
"""Error of a signal, of its own root mean square, that a steady wave held out may have."""
_SIGNALS = ("surge (m/s)", "sway (m/s)", "yaw rate (rad/s)")


def report(result: dict[str, Any], swum: Array, truth: Array, out: Path) -> None:
    """Write README.md and twin.png.

    Args:
        result: What ``twin_fit.fit`` found.
        swum: What the twin shows, shape (E, T, 6).
        truth: What the fluid shows, likewise.
        out: Where to.
    """
    rows = result["rows"]
    (out / "README.md").write_text("\n".join([*_head(result), *_table(rows), *_sums(rows)]) + "\n")
    _picture(rows, swum, truth, out / "twin.png")


def _head(result: dict[str, Any]) -> list[str]:
    rows = result["rows"]
    held = sum(row["held_out"] for row in rows)
    lines = [
        "# How well the twin stands in for the fluid\n",
        f"`python benchmarks/twin_fit.py`: the fluid in cells of {100 * result['cell_m']:g} cm,"
        f" {len(rows)} swims of ten seconds,",
        f"the last {held} not seen by the fit. The coefficients' meaning: `sim/twin/law.py`.\n",
        "| coefficient | fitted | standard deviation |",
        "|---|---:|---:|",
    ]
    for name, value in result["coefficients"].items():
        lines.append(f"| {name} | {value:.3g} | {100 * result['relative_sd'][name]:.0f} % |")
    lines.append(
        "\nThe deviations are those of the swims' scatter. The fit's condition (slopes scaled to"
        f" length 1) is {result['condition']:.0f};\nthe starts end at costs of "
        + ", ".join(f"{cost:.2f}" for cost in result["costs"])
        + ".\n"
    )
    return lines


def _table(rows: list[dict[str, Any]]) -> list[str]:
    lines = [
        "| swim | mean surge, fluid | twin | surge | sway | yaw rate |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for row in rows:
        name = row["signal"] + ("" if row["steady"] else " (unsteady)")
        name += " (held out)" if row["held_out"] else ""
        errors = " | ".join(f"{100 * e:.1f} %" for e in row["error"][:3])
        twin, real = row["mean_surge"]
        lines.append(f"| {name} | {real:.3f} | {twin:.3f} | {errors} |")
    return lines


def _sums(rows: list[dict[str, Any]]) -> list[str]:
    lines = [
        "\nMean surge in m/s over the last five seconds; errors are root mean square, of the"
        " fluid's own root mean square.\n",
        f"| steady waves (bar {100 * BAR:.0f} %) | surge | sway | yaw rate |",
        "|---|---:|---:|---:|",
    ]
    for label, held in (("fitted", False), ("held out", True)):
        some = [row["error"][:3] for row in rows if row["steady"] and row["held_out"] == held]
        for kind, values in (
            ("root mean square", np.sqrt(np.mean(np.square(some), axis=0))),
            ("worst", np.max(some, axis=0)),
        ):
            text = " | ".join(f"{100 * v:.1f} %" for v in values)
            lines.append(f"| {label}, {kind} | {text} |")
    return [*lines, "\n![Surge, sway, yaw rate of the swims held out](twin.png)"]


def _picture(rows: list[dict[str, Any]], swum: Array, truth: Array, path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    t = CONTROL_S * np.arange(1, truth.shape[1] + 1)
    held = [k for k, row in enumerate(rows) if row["held_out"]]
    figure, axes = plt.subplots(
        3, len(held), figsize=(3 * len(held), 6), sharex=True, layout="constrained", squeeze=False
    )
    for column, k in enumerate(held):
        for i, name in enumerate(_SIGNALS):
            axes[i, column].plot(t, truth[k, :, i], color="#19528c", label="fluid")
            axes[i, column].plot(t, swum[k, :, i], color="#b8381d", label="twin", linewidth=1)
            axes[i, column].set_title(f"{100 * rows[k]['error'][i]:.0f} %", fontsize=8, loc="right")
            if column == 0:
                axes[i, 0].set_ylabel(name)
        axes[0, column].set_title(rows[k]["signal"], fontsize=9, loc="left")
        axes[2, column].set_xlabel("time (s)")
    axes[0, 0].legend(frameon=False, fontsize=8)
    figure.savefig(path, dpi=110)
    plt.close(figure)
