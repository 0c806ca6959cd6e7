"""How the three-joint robot's swimming speed depends on the size of the cells, in three dimensions.

    python benchmarks/resolution.py [--device cuda:0] [--cells 0.02 0.01 0.005] [--out FOLDER]

The robot swims with its servos under travelling waves; its speed is that of the last seconds. What
coarse cells cost is put right by one number, an added form drag (negative: relief), chosen on the
first wave alone and judged on the others. Writes ``resolution.json`` and ``resolution.png``.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from fluid_speed import MODEL, ROBOT
from numpy.typing import NDArray
from tqdm import tqdm

from sim.swimmer import CONTROL_S, Swimmer
from sim2real.body import listed

Array = NDArray[np.float64]

VISCOSITY_M2_S = 5e-5
"""The same at all sizes, so that only the cells differ: the least that is safe at 2 cm."""
SECONDS, COUNTED = 12.0, 4.0
RELIEF = -np.array([0.0, 0.3, 0.5, 0.6, 0.7, 0.8, 1.0, 1.25, 1.5, 2.0, 2.5, 3.0])
"""Added form drag that is tried on coarse cells."""


@dataclass(frozen=True)
class Wave:
    """A travelling wave of set-points.

    Attributes:
        hertz: Its frequency; a whole number of beats is counted.
        scale: Of the amplitudes 0.30, 0.45, 0.60 rad.
    """

    hertz: float
    scale: float

    def command(self, t: float) -> Array:
        """Set-points in rad, growing over the first second, shape (3,)."""
        bend = np.array([0.30, 0.45, 0.60]) * np.sin(
            2 * np.pi * self.hertz * t - 1.2 * np.arange(3)
        )
        return np.asarray(min(1.0, t) * self.scale * bend)

    @property
    def name(self) -> str:
        """For tables."""
        return f"{self.hertz:g} Hz x {self.scale:g}"


WAVES = (Wave(1.0, 1.0), Wave(1.5, 0.8), Wave(0.75, 1.2), Wave(1.0, 0.7))


def main() -> None:
    """Swim at each size, correct the coarse ones, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--cells", type=float, nargs="+", default=[0.04, 0.02])
    parser.add_argument("--out", type=Path, default=Path("reports/resolution"))
    options = parser.parse_args()
    finest = min(options.cells)
    rows = []
    for cell in sorted(options.cells, reverse=True):
        relief = RELIEF if cell > finest else RELIEF[:1]
        speed, more = swim(cell, options.device, relief)
        rows.append({"cell_m": cell, "speed_m_s": speed.tolist(), "relief": relief.tolist()} | more)
        shown = "  ".join(f"{w.name} {v:.4f}" for w, v in zip(WAVES, speed[:, 0], strict=True))
        print(f"{cell:g} m: {shown} m/s ({more['wall_s']:.0f} s)", flush=True)
    fine = np.array(rows[-1]["speed_m_s"])[:, 0]
    for row in rows[:-1]:
        row["corrected"] = corrected(np.array(row["speed_m_s"]), fine)
        print(f"{row['cell_m']:g} m: {row['corrected']}")
    result: dict[str, Any] = {"waves": [wave.name for wave in WAVES], "rows": rows}
    if len(rows) >= 3:
        result["order"] = order([np.array(row["speed_m_s"])[:, 0] for row in rows[-3:]])
        print(f"order seen: {result['order']}")
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "resolution.json").write_text(json.dumps(result, indent=1) + "\n")
    draw(result, options.out / "resolution.png")


def draw(result: dict[str, Any], target: Path) -> None:
    """Speed against the cell, and with the correction that the first wave chose."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7, 4.4), layout="constrained")
    rows = result["rows"]
    for k, wave in enumerate(result["waves"]):
        speed = [row["speed_m_s"][k][0] for row in rows]
        (line,) = axes.plot([100 * row["cell_m"] for row in rows], speed, "o-", label=wave)
        for row in rows[:-1]:
            after = speed[-1] * (1 + row["corrected"]["after"][k])
            axes.plot(100 * row["cell_m"], after, "s", mfc="none", color=line.get_color())
    axes.invert_xaxis()
    axes.set(xlabel="side of a cell (cm)", ylabel="speed (m/s)")
    axes.legend(frameon=False, title="wave; squares: corrected by one form drag")
    figure.savefig(target, dpi=120)


def corrected(speed: Array, fine: Array) -> dict[str, Any]:
    """The relief that gives the first wave its fine speed, and what it does to the others."""
    first = np.where(np.isfinite(speed[0]), speed[0], -np.inf)
    best = int(np.argmax(first))
    rising = first[: best + 1]
    relief = float(np.interp(fine[0], rising, RELIEF[: best + 1]))
    others = [float(np.interp(-relief, -RELIEF[: best + 1], row[: best + 1])) for row in speed]
    return {
        "form_drag": relief,
        "reached": bool(first[best] >= fine[0]),
        "before": (speed[:, 0] / fine - 1).round(3).tolist(),
        "after": (np.array(others) / fine - 1).round(3).tolist(),
    }


def order(speeds: list[Array]) -> list[float | None]:
    """Order of convergence of each wave's speed; None where the differences don't shrink."""
    coarse, middle, fine = speeds
    ratio = (middle - coarse) / (fine - middle)
    return [round(float(np.log2(r)), 2) if r > 1 else None for r in ratio]


def swim(cell: float, device: str, relief: Array) -> tuple[Array, dict[str, Any]]:
    """Speed of each wave under each relief, shape (waves, reliefs); NaN where it broke down."""
    models = [
        replace(MODEL, body={"effects": listed({"form_drag.coefficient": float(c)})})
        for _ in WAVES
        for c in relief
    ]
    swimmer = Swimmer(
        ROBOT, models, n_envs=len(models), cell_m=cell, viscosity_m2_s=VISCOSITY_M2_S,
        device=device, threads=2,
    )  # fmt: skip
    start, path = time.perf_counter(), []
    for k in tqdm(range(round(SECONDS / CONTROL_S)), desc=f"{cell:g} m", disable=None):
        sent = np.repeat([wave.command(k * CONTROL_S) for wave in WAVES], len(relief), axis=0)
        swimmer.step(sent)
        path.append(swimmer.state().pose[:, :2])
    places, stopped = np.array(path), swimmer.state().stopped
    speed = np.full(len(models), np.nan)
    for k in range(len(models)):
        wave = WAVES[k // len(relief)]
        beats = round(COUNTED * wave.hertz)
        back = round(beats / wave.hertz / CONTROL_S)
        if stopped[k] < 0:
            moved = places[-1, k] - places[-1 - back, k]
            speed[k] = np.linalg.norm(moved) / (back * CONTROL_S)
    more = {"cells": swimmer.fluid.cells, "wall_s": time.perf_counter() - start}
    return speed.reshape(len(WAVES), len(relief)), more


if __name__ == "__main__":
    main()
