"""A standard excitation of a fitted joint, and the prediction of its model on it."""

from __future__ import annotations

import numpy as np

from sim2real.arrays import Array
from sim2real.model import JointModel
from sim2real.recording import PER_INERTIA, Load
from sim2real.servo.parameters import joint_row
from sim2real.servo.rollout import rollout
from sim2real.servo.trace import Trace

PERIOD_S, SECONDS = 0.01, 15.0
REACH_RAD = 0.6
_SEED = 20240


def commands(reach_rad: float = REACH_RAD) -> tuple[Array, dict[str, Array]]:
    """Random steps, a chirp from 0.1 to 2.5 Hz and a slow triangle wave.

    Args:
        reach_rad: Largest set-point.

    Returns:
        Times in s, shape (T,), and set-points in rad by name, each of shape (T,) and 0 at first.
    """
    t = PERIOD_S * np.arange(round(SECONDS / PERIOD_S), dtype=np.float64)
    rng = np.random.default_rng(_SEED)
    moves = 0.5 + np.cumsum(rng.uniform(0.3, 0.9, 50))
    levels = np.concatenate([[0.0], rng.uniform(-reach_rad, reach_rad, 50)])
    s = np.maximum(t - 0.5, 0.0)
    sweep = 0.1 * s + 0.5 * (2.5 - 0.1) / s[-1] * s**2
    wave: Array = (2 / np.pi) * np.arcsin(np.sin(2 * np.pi * 0.3 * s))
    return t, {
        "steps": levels[np.searchsorted(moves, t, side="right")],
        "chirp": 0.6 * reach_rad * np.sin(2 * np.pi * sweep),
        "triangle": reach_rad * wave,
    }


def excitation(joint: JointModel, name: str, reach_rad: float | None = None) -> list[Trace]:
    """Predictions of a joint's model on the standard commands, as noiseless traces.

    Args:
        joint: The fitted joint.
        name: Its name.
        reach_rad: Largest set-point; at most ``REACH_RAD``, the default.
    """
    t, signals = commands(min(reach_rad or REACH_RAD, REACH_RAD))
    load = PER_INERTIA if joint.per_inertia else joint.load or Load(joint.inertia_kgm2)
    row = joint_row(joint, load, where=f"model, {name}")
    return [
        Trace(
            name=kind,
            file=f"standard {kind}",
            t=t,
            command=sent,
            position=rollout(row[None], t, sent)[0],
            load=load,
            used=np.ones(t.size, dtype=bool),
        )
        for kind, sent in signals.items()
    ]
