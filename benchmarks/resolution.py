"""How the three-joint robot's swimming speed depends on the size of the cells, in three dimensions.

    python benchmarks/resolution.py [--device cuda:0] [--cells 0.02 0.01 0.005] [--out FOLDER]

The robot swims with its servos under one travelling wave; its speed is that of the last seconds.
Writes ``resolution.json``; prints the order seen, and the number that corrects the coarse grid.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
from fluid_speed import MODEL, ROBOT

from sim.swimmer import CONTROL_S, Swimmer

AMPLITUDE = np.array([0.30, 0.45, 0.60])
LAG = 1.2 * np.arange(3)
HERTZ = 1.0
VISCOSITY_M2_S = 5e-5
"""The same at all sizes, so that only the cells differ: the least that is safe at 2 cm."""
SECONDS, COUNTED = 10.0, 4.0


def main() -> None:
    """Swim at each size, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--cells", type=float, nargs="+", default=[0.04, 0.02])
    parser.add_argument("--out", type=Path, default=Path("reports/resolution"))
    options = parser.parse_args()
    rows = [swim(cell, options.device) for cell in options.cells]
    speed = [row["speed_m_s"] for row in rows]
    result = {"rows": rows}
    if len(rows) >= 3:
        coarse, middle, fine = speed[-3:]
        order = float(np.log2((middle - coarse) / (fine - middle)))
        result |= {"order": order, "at_zero_m_s": fine + (fine - middle) / (2**order - 1)}
        print(f"order {order:.2f}, extrapolated to {result['at_zero_m_s']:.4f} m/s")
    for row in rows[:-1]:
        print(f"{row['cell_m']:g} m: factor {speed[-1] / row['speed_m_s']:.3f} to the finest")
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "resolution.json").write_text(json.dumps(result, indent=1))


def swim(cell: float, device: str) -> dict[str, float]:
    """Speed along the path over the last seconds, and where the robot went."""
    swimmer = Swimmer(
        ROBOT, MODEL, cell_m=cell, viscosity_m2_s=VISCOSITY_M2_S, device=device, threads=2
    )
    start, path = time.perf_counter(), []
    for k in range(round(SECONDS / CONTROL_S)):
        t = k * CONTROL_S
        swimmer.step(min(1.0, t) * AMPLITUDE * np.sin(2 * np.pi * HERTZ * t - LAG))
        path.append(swimmer.state().pose[0])
    cycle = round(1 / HERTZ / CONTROL_S)
    places = np.array(path)[::-cycle][: round(COUNTED * HERTZ) + 1, :2]
    speed = float(np.linalg.norm(places[0] - places[-1]) / COUNTED)
    row = {
        "cell_m": cell, "speed_m_s": speed, "cells": swimmer.fluid.cells,
        "substeps": swimmer.substeps, "viscosity_m2_s": float(swimmer.viscosity_m2_s[0]),
        "wall_s": time.perf_counter() - start, "stopped": int(swimmer.state().stopped[0]),
    }  # fmt: skip
    print("  ".join(f"{key} {value:.4g}" for key, value in row.items()), flush=True)
    return row


if __name__ == "__main__":
    main()
