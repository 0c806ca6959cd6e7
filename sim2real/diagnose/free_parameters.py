"""Servos whose gains, and the parameters of whose effects, are free in a fit."""

from __future__ import annotations

import numpy as np

from sim2real.arrays import Array, Integers, Mask
from sim2real.diagnose.screening import NUISANCES, candidate
from sim2real.effects import named
from sim2real.identification.servo_problem import Servos, Set
from sim2real.servo.parameters import COLUMNS, CONTROL_SIDE, FIRST_EFFECT_COLUMN

BRANCHES = CONTROL_SIDE, "restitution", "step_share"
"""Parameters whose fits have a branch at 0 and another one: of gear trains, of dead bands."""
SIDE_COLUMNS, BRANCH_COLUMNS = (
    [k for k, name in enumerate(COLUMNS) if name.rpartition(".")[2] in some]
    for some in ((CONTROL_SIDE,), BRANCHES)
)
_FIELDS = ("columns", "unit", "low", "high")
"""Fields of free parameters that servos and candidates have."""
_SENSOR = {"sensor_gain": "gain", "sensor_offset": "offset_rad"}
_WAVES = [
    [COLUMNS.index(f"{effect.name}.{name}_rad") for name in ("period", "phase")]
    for effect in NUISANCES
]
"""Columns of the waves of the angle that every servo has."""


def with_effects(
    plain: Servos, effects: Set, theta: Array, inertia: float, fixed: Set = frozenset()
) -> Servos:
    """A servo whose gains, latency, line and parameters of effects are free, from a row (P,).

    Effects are scaled to the kp of the plain servo and an inertia in kg m2; those that are
    ``fixed`` stay as they are in ``theta``, and other effects are dropped.
    """
    kp = float(plain.theta[0, 0])
    options = [candidate(named(e), kp, inertia) for e in sorted(effects) if named(e).fitted]
    row = np.zeros_like(theta)
    row[:FIRST_EFFECT_COLUMN] = theta[:FIRST_EFFECT_COLUMN]
    for option in options:
        row[option.columns] = theta[option.columns]
    added = [option for option in options if option.effect.name not in fixed]
    free = [own_parameters(plain), *(~in_its_branch(row, one.columns) for one in added)]
    parts = (
        [getattr(plain, field)[0] for field in _FIELDS],
        *([getattr(one, field) for field in _FIELDS] for one in added),
    )
    fields = zip(*parts, strict=True)
    return Servos(
        plain.joint,
        row[None],
        *(np.concatenate([x[k] for x, k in zip(of, free, strict=True)])[None] for of in fields),
    )


def in_its_branch(row: Array, columns: Integers) -> Mask:
    """Which parameters of a row (P,) stay as they are: the controller's side, branches at 0."""
    return np.asarray(
        np.isin(columns, SIDE_COLUMNS) | np.isin(columns, BRANCH_COLUMNS) & (row[columns] == 0)
    )


def own_parameters(servos: Servos) -> Mask:
    """Which of one servo's free parameters are no effect's, shape (F,)."""
    columns = servos.columns[0]
    return np.asarray((columns >= 0) & (columns < FIRST_EFFECT_COLUMN))


def as_read(theta: Array, members: Set) -> Array:
    """A row (P,) whose waves of the angle are as the sensor shows them, where its errors leave.

    Where a gain or an offset of the sensor is not among the members, what stands for it bends the
    servo as much. No fit mends a period that is off by some of its waves.
    """
    gain, offset = (
        0.0 if effect in members else theta[COLUMNS.index(f"{effect}.{name}")]
        for effect, name in _SENSOR.items()
    )
    row = theta.copy()
    for period, phase in _WAVES:
        if row[period] > 0 and (gain or offset):
            row[period] *= 1 + gain
            turned = row[phase] - 2 * np.pi * offset / row[period]
            row[phase] = (turned + np.pi) % (2 * np.pi) - np.pi
    return row
