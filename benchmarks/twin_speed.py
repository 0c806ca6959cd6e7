"""How much faster than life the reduced-order twin swims a batch.

python benchmarks/twin_speed.py [--robots 256] [--device cpu]
"""

from __future__ import annotations

import time

import numpy as np
from fluid_speed import MODEL, ROBOT
from harness import command_line

from sim.robot.swimmer import CONTROL_S
from sim.twin.twin import SUBSTEPS, Twin

SECONDS = 12.0


def main() -> None:
    """Swim once to compile, then three times; the best counts."""
    options = command_line(__doc__, robots=256, device="cpu").parse_args()
    times = CONTROL_S * np.arange(round(SECONDS / CONTROL_S))
    wave = np.sin(2 * np.pi * times[:, None] - 1.2 * np.arange(3))
    sent = np.minimum(1.0, times)[:, None] * np.array([0.3, 0.45, 0.6]) * wave
    twin = Twin(ROBOT, MODEL, n_envs=options.robots, device=options.device)
    twin.swim(sent[:10])
    best = np.inf
    for _ in range(3):
        start = time.perf_counter()
        twin.swim(sent)
        best = min(best, time.perf_counter() - start)
    factor = options.robots * SECONDS / best
    print(
        f"{options.robots} robots, {SUBSTEPS} sub-steps a period, {options.device}: "
        f"{factor:.0f} times real time (bar 2000)"
    )


if __name__ == "__main__":
    main()
