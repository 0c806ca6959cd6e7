"""The twin beside a robot that was filmed: carried to where it was seen, time and again.

Water does not mind where a robot is or where it heads, but a cable and a wall do, and a twin that
swims on its own is soon elsewhere. So it is put to the pose that was seen every few seconds, moving
as it moved; the track goes on without a jump, put together from the ways between.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from sim.calibration.emulator import path_of, steps_of
from sim.inference.blocks import bounds
from sim.inference.coordinates import Swum
from sim.inference.swims import Swim
from sim.robot.swimmer import CONTROL_S
from sim.twin.prescribed import carry
from sim.twin.twin import Twin
from sim2real.model import Model
from sim2real.robot import Robot

Array = NDArray[np.float64]


SUBSTEPS = 4
"""Of a control period: half the twin's own moves a swim by a percent, far below its error."""


def by_followed_twin(robot: Robot, **given: Any) -> Swum:  # noqa: ANN401 - options of Twin
    """The twin for swims whose poses are known."""
    options = {"substeps": SUBSTEPS, **given}

    def run(models: Sequence[Model], swim: Swim) -> Array:
        twin = Twin(robot, models, n_envs=len(models), **options)
        twin.reset(pose=np.tile(swim.start, (len(models), 1)))
        seen = swim.start[None] if swim.pose is None else uniform_filter1d(swim.pose, 5, axis=0)
        state = twin.state()
        now = np.concatenate([state.pose, state.measured], axis=1)
        joint, ways = state.measured, []
        sent = swim.command[:-1]
        for a, b in bounds(len(sent), CONTROL_S):
            if a and swim.pose is not None:
                carry(twin, seen[a])
                now = np.concatenate([np.tile(seen[a], (len(models), 1)), now[:, 3:]], axis=1)
            track = np.concatenate([now[:, None], twin.swim(sent[a:b])], axis=1)
            ways.append(steps_of(track))
            now = track[:, -1]
        return path_of(np.concatenate(ways, axis=1), swim.start, joint)

    return run
