"""Record a simulated SO-101: two recordings of steps and two of multisines, and the truth.

python datasets/so101/record_arm.py --out recordings [--worn]
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import arm_plant
import numpy as np
from tqdm import tqdm

from sim2real.output import write_json
from sim2real.recording import write_recording

PERIOD_S = 0.02


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the recordings and ``truth.json``."""
    parser = argparse.ArgumentParser(description="Record a simulated SO-101.")
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--worn", action="store_true", help="with dry friction and play")
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--seed", type=int, default=101)
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(options.seed)
    physics = arm_plant.WORN if options.worn else arm_plant.Physics()
    t = PERIOD_S * np.arange(round(options.seconds / PERIOD_S))
    for name in tqdm(("steps1", "multisines1", "steps2", "multisines2"), disable=None):
        signal = arm_plant.steps if name.startswith("steps") else arm_plant.multisines
        recording, _ = arm_plant.recorded(name, signal(t, rng), t, physics, rng)
        write_recording(recording, options.out / f"{name}.csv")
    servos = {name: np.asarray(value).tolist() for name, value in vars(physics).items()}
    write_json(options.out / "truth.json", {"joints": list(arm_plant.NAMES), **servos})


if __name__ == "__main__":
    main()
