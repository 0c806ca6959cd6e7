"""How much a robot's heading in its box of cells changes its speed: of water itself, not at all.

    python benchmarks/heading_in_a_box.py OUT.json [--device cuda:0]

The robot of ``datasets/pool`` swims the same wave in several headings, in the boxes with which
swims are diagnosed (``sim.inference.in_water``), in square ones and in finer cells.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from sim.inference.in_water import BOX_M, CELL_M, VISCOSITY_M2_S
from sim.robot.swimmer import CONTROL_S, Swimmer
from sim2real.model import read_model
from sim2real.robot import read_robot

POOL = Path(__file__).parents[1] / "datasets" / "pool"
HEADINGS_DEG = (0.0, 15.0, 30.0, 45.0, 60.0, 75.0, 90.0)
SECONDS, LAST = 8.0, 3.0
SIZE_RAD, HERTZ, LAG_RAD = 0.35, 1.0, 1.1


def speeds(cell_m: float, box_m: tuple[float, float, float], device: str) -> list[float]:
    """Mean surge in m/s in each heading over the last seconds, shape (headings,)."""
    robot, model = read_robot(POOL / "robot.toml"), read_model(POOL / "model.json")
    swimmer = Swimmer(
        robot, model, n_envs=len(HEADINGS_DEG), cell_m=cell_m, box_m=box_m, device=device,
        viscosity_m2_s=VISCOSITY_M2_S,
    )  # fmt: skip
    headings = np.deg2rad(HEADINGS_DEG)
    swimmer.reset(pose=np.stack([0 * headings, 0 * headings, headings], axis=1))
    seen = []
    for k in range(round(SECONDS / CONTROL_S)):
        phase = 2 * np.pi * HERTZ * k * CONTROL_S - LAG_RAD * np.arange(len(robot.joints))
        swimmer.step(SIZE_RAD * min(1.0, k * CONTROL_S) * np.sin(phase))
        seen.append(swimmer.state().velocity[:, 0])
    return [float(v) for v in np.mean(seen[-round(LAST / CONTROL_S) :], axis=0)]


def main() -> None:
    """Swim, write, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--device", default="cpu")
    options = parser.parse_args()
    square = (BOX_M[0], BOX_M[0], BOX_M[2])
    found = []
    for name, cell_m, box_m in (
        ("as diagnosed", CELL_M, BOX_M), ("square", CELL_M, square), ("finer", 0.01, BOX_M),
        ("finer, square", 0.01, square),
    ):  # fmt: skip
        speed = speeds(cell_m, box_m, options.device)
        spread = (max(speed) - min(speed)) / float(np.mean(speed))
        row = {"box": name, "cell_m": cell_m, "box_m": list(box_m), "m_s": speed, "spread": spread}
        found.append(row)
        print(f"{name:14s} {cell_m:g} m:", *(f"{v:.3f}" for v in speed), f"{100 * spread:.1f} %")
        options.out.write_text(json.dumps({"headings_deg": HEADINGS_DEG, "rows": found}) + "\n")


if __name__ == "__main__":
    main()
