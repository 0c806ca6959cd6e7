"""The plant of the sealed challenge, ``datasets/concealed``, as one of several."""

from __future__ import annotations

import numpy as np
from bench import as_records
from catalogue import EFFECTS
from foreign_servos import ForeignServo
from foreign_world import Acting
from numpy.typing import NDArray
from outside import OUTSIDERS
from rollout import simulate as march
from world import MOST_WINDOWS, World

Array = NDArray[np.float64]


def simulate_all(
    servos: list[ForeignServo],
    recording: str,
    acting: list[Acting],
    grid: Array,
    arrivals: list[Array],
    setpoints: list[Array],
    windows: list[list[tuple[float, float]]],
) -> Array:
    """The angles that the recorded sensors see, rad, shape (J, T), at the times ``grid``."""
    joints = as_records(list(servos), recording)
    world = World(joints)
    spans = np.full((len(servos), MOST_WINDOWS, 2), np.inf)
    count = max(a.size for a in arrivals)
    when, what = np.full((len(servos), count), np.inf), np.zeros((len(servos), count))
    for j, effects in enumerate(acting):
        world.windows[j] = windows[j]
        for k, window in enumerate(windows[j]):
            spans[j, k] = window
        for name, parameters in effects.items():
            (EFFECTS[name] if name in EFFECTS else OUTSIDERS[name]).hide(world, j, parameters)
        joints["friction_Nm"][j] += servos[j].dry_friction_Nm
        when[j, : arrivals[j].size], what[j, : setpoints[j].size] = arrivals[j], setpoints[j]
    joints["latency_s"] = 0.0  # the link has seen to it
    return march(joints, world.supply, spans, grid, when, what).seen
