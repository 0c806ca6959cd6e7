"""How often ``sim.inference.resistance`` sees drag where only the twin's law is another.

    python benchmarks/resistance_nulls.py [--robots 40] [--swims 3] [--seed 20261125]

Robots are drawn as in the pool's development sets, and the coefficients of each robot's law from
what is known of the law's error (``law_error.json``); each swims a drawn command signal in that
law, with nothing missing. Prints quantiles of the evidence for an area that is not there, against
which the threshold ``resistance`` in ``law_error.json`` was checked, and of an area of a tenth and
a third of the robot's side that is there.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

from sim.inference.coordinates import Coordinates
from sim.inference.law_error import LAW_ERROR
from sim.inference.resistance import AREA, PLACE, resistance
from sim.inference.swims import Swim, by_twin, simulated, with_values
from sim.robot.swimmer import CONTROL_S
from sim2real.arrays import Array
from sim2real.model import JointModel, Model

sys.path.insert(0, str(Path(__file__).parents[1] / "datasets" / "pool"))
from drawn import command_of, robot_of  # noqa: E402

SHARES = (0.0, 0.1, 0.33)
"""Areas that are there, over the side of the robot."""
SECONDS = 10.0


def odds(seed: int, swims: int) -> Array:
    """Evidence of an area for one robot, by the area that is there."""
    rng = np.random.default_rng(seed)
    robot = robot_of(rng, f"robot {seed}").robot
    servo = JointModel(2.2, 0.06, 0.05, 0.002)
    model = Model(joints={joint.name: servo for joint in robot.joints}, body={})
    columns = Coordinates.of(robot, model)
    mean, covariance = LAW_ERROR.prior(columns)
    drawn = rng.multivariate_normal(mean, covariance)
    names = [c.name for c in columns.columns]
    law = {
        name: float(max(value, 0.0))
        for name, value in zip(names, drawn, strict=True)
        if name.startswith("twin.")
    }
    usual = {n: float(v) for n, v in zip(names, mean, strict=True) if n.startswith("twin.")}
    side = sum(link.length_m * link.height_m for link in robot.links)
    commands = [
        command_of(rng, len(robot.joints), CONTROL_S, SECONDS)[: round(SECONDS / CONTROL_S)]
        for _ in range(swims)
    ]
    simulator = by_twin(robot, threads=1)

    def signals(models: Sequence[Model], swim: Swim) -> Array:
        return simulated(swim, models, simulator)

    out = []
    for share in SHARES:
        there = {AREA: share * side, PLACE: robot.links[0].length_m / 2}
        truth = with_values(model, law | (there if share else {}))
        recorded = []
        for k, command in enumerate(commands):
            t = CONTROL_S * np.arange(len(command))
            blank = Swim(f"swim {k}", t, command, np.zeros(3), np.empty((len(command), 0)))
            (seen,) = simulated(blank, [truth], simulator)
            recorded.append(Swim(f"swim {k}", t, command, np.zeros(3), seen))
        out.append(resistance(recorded, with_values(model, usual), robot, signals).log_odds)
    return np.array(out)


def main() -> None:
    """Draw, estimate, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", type=int, default=40)
    parser.add_argument("--swims", type=int, default=3)
    parser.add_argument("--seed", type=int, default=20261125)
    parser.add_argument("--processes", type=int, default=1)
    options = parser.parse_args()
    seeds = options.seed + np.arange(options.robots)
    with ProcessPoolExecutor(options.processes) as pool:
        found = np.array(list(pool.map(odds, seeds, [options.swims] * options.robots)))
    print("evidence of an area: smallest, median, 90 %, largest; share beyond the threshold")
    for share, column in zip(SHARES, found.T, strict=True):
        figures = " ".join(f"{v:7.1f}" for v in np.quantile(column, (0, 0.5, 0.9, 1)))
        named = np.mean(column > LAW_ERROR.decisions["resistance"])
        print(f"  {share:4.2f} of the side: {figures} {named:.2f}")


if __name__ == "__main__":
    main()
