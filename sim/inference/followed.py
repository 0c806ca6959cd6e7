"""The twin, reset to the measured pose of a robot every few seconds.

Forces of the water do not depend on position or heading, but those of a cable and a wall do, and
the path of a free simulation soon differs from the measured one. So every few seconds the twin is
moved to the measured pose, with its velocity in the body frame kept. The track is integrated from
the displacements of all periods and has no jumps.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.ndimage import uniform_filter1d

from sim.calibration.emulator import path_of, steps_of
from sim.inference.blocks import bounds
from sim.inference.coordinates import SwimSimulator
from sim.inference.swims import Swim
from sim.robot.swimmer import CONTROL_S
from sim.twin.prescribed import carry
from sim.twin.twin import Twin
from sim2real.arrays import Array
from sim2real.model import Model
from sim2real.robot import Robot

SUBSTEPS = 4
"""Sub-steps of a control period, half the twin's default: this changes a swim by 1 %, far less than
its error."""


def by_followed_twin(robot: Robot, **settings: Any) -> SwimSimulator:  # noqa: ANN401 - options of Twin
    """The twin as a simulator for swims with measured poses."""
    options = {"substeps": SUBSTEPS, **settings}

    def run(models: Sequence[Model], swim: Swim) -> Array:
        twin = Twin(robot, models, n_envs=len(models), **options)
        twin.reset(pose=np.tile(swim.start, (len(models), 1)))
        measured = swim.start[None] if swim.pose is None else uniform_filter1d(swim.pose, 5, axis=0)
        state = twin.state()
        signals = np.concatenate([state.pose, state.measured], axis=1)
        angles, displacements = state.measured, []
        commands = swim.command[:-1]
        for a, b in bounds(len(commands), CONTROL_S):
            if a and swim.pose is not None:
                carry(twin, measured[a])
                signals = np.concatenate(
                    [np.tile(measured[a], (len(models), 1)), signals[:, 3:]], axis=1
                )
            track = np.concatenate([signals[:, None], twin.swim(commands[a:b])], axis=1)
            displacements.append(steps_of(track))
            signals = track[:, -1]
        return path_of(np.concatenate(displacements, axis=1), swim.start, angles)

    return run
