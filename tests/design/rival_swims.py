"""Two rival sets of effects of a swim: linear drag and added mass, as a swim left them."""

from pathlib import Path

import numpy as np

from sim2real.diagnose.rival_sets import SwimRivals, SwimSet
from sim2real.model import read_model
from sim2real.robot import read_robot

POOL = Path(__file__).resolve().parents[2] / "datasets" / "pool"
FISH, SERVOS = read_robot(POOL / "robot.toml"), read_model(POOL / "model.json")
LAW = {"twin.along": (0.42, 0.1), "twin.thrust": (1.15, 0.1)}
IMITATION = {"linear_drag.coefficient": 0.02, "added_mass.ratio": 0.02}


def swim_set(probability, name, value, sd):
    coordinates = LAW | {name: (value, sd)}
    information = np.diag([sd**-2.0 for _, sd in coordinates.values()])
    values = {name: x for name, (x, _) in coordinates.items()}
    return SwimSet((name.partition(".")[0],), probability, values, information)


def swim_rivals(imitation=IMITATION, size=0.3):
    return SwimRivals(
        component="body",
        period_s=0.02,
        pose_sd=np.array([0.002, 0.002, 0.008]),
        pose_lag_s=0.0,
        joint_sd_rad=np.full(3, 0.0015),
        shares=np.full((4, 3), 0.3),
        imitation=imitation,
        relative=0.1,
        temperature=1.0,
        sets=(
            swim_set(0.6, "linear_drag.coefficient", size, 0.1),
            swim_set(0.4, "added_mass.ratio", 0.5 * size, 0.1),
        ),
    )
