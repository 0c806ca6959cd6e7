"""How much a robot's heading in its box of cells changes its speed: of water itself, not at all.

    python benchmarks/heading_in_a_box.py OUT.json [--device cuda:0] [--cells 0.01 0.02]

The robot of ``datasets/pool`` swims the same waves in several headings, in the boxes with which
swims are diagnosed (``sim.inference.in_water``) and cells of several sizes.
"""

from __future__ import annotations

import json
from itertools import product
from pathlib import Path

import numpy as np
from harness import command_line
from tqdm import tqdm

from sim.inference.in_water import BOX_M, VISCOSITY_M2_S
from sim.robot.swimmer import CONTROL_S, Swimmer
from sim2real.arrays import Array
from sim2real.model import read_model
from sim2real.robot import read_robot

POOL = Path(__file__).parents[1] / "datasets" / "pool"
HEADINGS_DEG = (0.0, 15.0, 30.0, 45.0, 60.0, 75.0, 90.0)
SECONDS, LAST = 8.0, 3.0
WAVES = ((0.25, 1.2), (0.35, 1.0), (0.5, 1.5))
"""Amplitudes in rad and frequencies in Hz."""
LAG_RAD = 1.1


def speeds(cell_m: float, wave: tuple[float, float], device: str) -> Array:
    """Mean surge in m/s in each heading over the last seconds, shape (headings,)."""
    robot, model = read_robot(POOL / "robot.toml"), read_model(POOL / "model.json")
    swimmer = Swimmer(
        robot, model, n_envs=len(HEADINGS_DEG), cell_m=cell_m, box_m=BOX_M, device=device,
        viscosity_m2_s=VISCOSITY_M2_S,
    )  # fmt: skip
    headings = np.deg2rad(HEADINGS_DEG)
    swimmer.reset(pose=np.stack([0 * headings, 0 * headings, headings], axis=1))
    surge = []
    size_rad, hertz = wave
    for k in range(round(SECONDS / CONTROL_S)):
        phase = 2 * np.pi * hertz * k * CONTROL_S - LAG_RAD * np.arange(len(robot.joints))
        swimmer.step(size_rad * min(1.0, k * CONTROL_S) * np.sin(phase))
        surge.append(swimmer.state().velocity[:, 0])
    mean: Array = np.mean(surge[-round(LAST / CONTROL_S) :], axis=0)
    return mean


def main() -> None:
    """Swim, write, print."""
    cells = ([0.01, 0.012, 0.016, 0.02], "their sides, in m")
    options = command_line(__doc__, "out", device="cpu", cells=cells).parse_args()
    found = []
    for cell_m, wave in tqdm(list(product(options.cells, WAVES)), disable=None):
        speed = speeds(cell_m, wave, options.device)
        spread = float(np.ptp(speed) / np.mean(speed))
        found.append({"cell_m": cell_m, "wave": wave, "m_s": speed.tolist(), "spread": spread})
        line = [cell_m, wave, *(f"{v:.3f}" for v in speed), f"{100 * spread:.1f} %"]
        tqdm.write(" ".join(map(str, line)))
        options.out.write_text(json.dumps({"headings_deg": HEADINGS_DEG, "rows": found}) + "\n")


if __name__ == "__main__":
    main()
