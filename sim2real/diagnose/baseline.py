"""The plain servo of every joint of a batch, and the servo that has effects besides."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim2real.arrays import Array, Mask
from sim2real.diagnose.screening import NUISANCES, candidate
from sim2real.effects import named
from sim2real.identification.servo_problem import (
    Fits,
    Servos,
    Set,
    Tried,
    minimise,
    plain_servos,
    stacked,
)
from sim2real.identification.starts import servos_at
from sim2real.inference.parameters import kronecker
from sim2real.model import JointModel
from sim2real.servo.batch import Batch, Problems
from sim2real.servo.parameters import BASE, COLUMNS, FIRST_EFFECT_COLUMN, joint_row

BLOCKS = 20
"""Blocks of each recording for bootstraps."""
_SENSOR = {"sensor_gain": "gain", "sensor_offset": "offset_rad"}
_WAVES = [
    [COLUMNS.index(f"{effect.name}.{name}_rad") for name in ("period", "phase")]
    for effect in NUISANCES
]
"""Columns of the waves of the angle that every servo has."""


def baselines(
    batch: Batch,
    given: Sequence[JointModel | None] = (),
    *,
    candidates: int = 256,
    refined: int = 3,
) -> Fits:
    """Fit the plain servo to every joint of a batch, with no guess by hand.

    Starts are ``candidates`` servos, and ``given`` models, one a joint, where there are any.
    """
    J, K = batch.recordings.size, candidates
    inertia = batch.load[batch.first_signal, 0]
    theta = np.zeros((J, K, len(COLUMNS)))
    theta[:, :, :3] = servos_at(kronecker(K, 3, np.random.default_rng(0)), inertia[:, None])
    joint = np.repeat(np.arange(J, dtype=np.int32), K)
    problems = Problems(joint, theta.reshape(J * K, 1, -1), np.zeros((J * K, 1)))
    white = np.zeros((J * K, batch.lags))
    looks = batch.evaluate(problems, autoregression=white, rough=True)
    best = np.argsort(looks.square[:, 0].reshape(J, K), axis=1)[:, :6]
    starts = np.take_along_axis(theta, best[:, :, None], axis=1)
    if any(given):
        known = starts[:, :1].copy()
        for j, model in enumerate(given):
            if model is not None:
                known[j] = joint_row(model, None)
        starts = np.concatenate([starts, known], axis=1)
        starts[:, :, len(BASE) :] = known[:, :, len(BASE) :]
    K = starts.shape[1]
    joint, rows = np.repeat(np.arange(J), K), starts.reshape(J * K, -1)
    servos = plain_servos(joint, rows, inertia[joint], batch.period, free_line=True)
    rough = minimise(batch, servos, iterations=12, white=True)
    order = np.argsort(rough.error2.reshape(J, K), axis=1)[:, :refined]
    pick = (np.arange(J)[:, None] * K + order).ravel()
    fine = minimise(batch, rough[pick].servos, iterations=12, blocks=BLOCKS)
    best = fine.error2.reshape(J, -1).argmin(axis=1)
    return fine[np.arange(J) * order.shape[1] + best]


def plain_again(batch: Batch, known: Sequence[Tried], bases: Sequence[Set]) -> Fits:
    """Fit the plain servos that are known of such a batch to this one; bases are as given."""
    servos = []
    for j, (tried, base) in enumerate(zip(known, bases, strict=True)):
        plain = tried.plain.fit.servos
        inertia = float(batch.load[batch.first_signal[j], 0])
        servo = with_effects(plain, base, plain.theta[0], inertia, base)
        servos.append(servo.of_joints([j]))
    return minimise(batch, stacked(servos), iterations=12, blocks=BLOCKS)


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
    own = own_parameters(plain)
    free = (
        np.concatenate([getattr(plain, field)[0, own], *(getattr(c, field) for c in added)])[None]
        for field in ("columns", "unit", "low", "high")
    )
    return Servos(plain.joint, row[None], *free)


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
