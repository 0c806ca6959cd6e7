"""Latency of many episodes of a joint whose gains they share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sim2real.model import JointModel
from sim2real.servo.batch import Batch
from sim2real.servo.parameters import joint_row
from sim2real.servo.problem import Fits, Servos, minimise, plain_servos
from sim2real.servo.trace import Trace

Array = NDArray[np.float64]

GAIN_SD = 0.02
"""How far the gains of one episode may be from those shared, as a share of them."""
_ITERATIONS, _ROUNDS = 30, 3
_LARGEST_CHANGE = 0.5


def episode_latencies(
    given: Sequence[Trace], joints: Sequence[JointModel], group: NDArray[np.intp]
) -> tuple[Array, Array]:
    """Latency of each trace and its standard deviation in s, each of shape (N,).

    A sine alone cannot tell latency from damping. So gains are shared by the traces of a group, and
    found together with a latency each, by Gauss-Newton steps from which the latencies are
    eliminated (Golub and Pereyra, SIAM Journal on Numerical Analysis 10 (1973) 413-432). What
    ``GAIN_SD`` of freedom in the gains would do to each latency counts into its error.

    Args:
        given: The traces.
        joints: The model of each one's joint, where the search starts; its effects stay.
        group: Which traces share gains, shape (N,), from 0 on.
    """
    batch = Batch([[one] for one in given])
    rows = np.array([joint_row(joint, one.load) for one, joint in zip(given, joints, strict=True)])
    inertia = np.array([one.load.inertia_kgm2 for one in given])
    servos = plain_servos(np.arange(len(given)), rows, inertia, batch.period)
    alone = minimise(batch, servos, iterations=_ITERATIONS)
    gains = _pooled(alone, _weights(alone, batch.lags), group)
    for _ in range(_ROUNDS):
        fits = _with_gains(batch, servos, alone, gains)
        gains = gains * (
            1 + _step(fits, _weights(fits, batch.lags), group, gains / servos.unit[:, :2])
        )
    fits = _with_gains(batch, servos, alone, gains)
    return fits.servos.theta[:, 2], _errors(fits, _weights(fits, batch.lags)) * servos.unit[:, 2]


def _with_gains(batch: Batch, servos: Servos, start: Fits, gains: Array) -> Fits:
    """Latencies fitted under given gains (N, 2), and there the curvature by all three."""
    x = start.servos.values()
    x[:, :2] = gains / servos.unit[:, :2]
    held = servos.at(x)
    only = Servos(
        held.joint, held.theta, held.columns[:, 2:], held.unit[:, 2:], held.low[:, 2:],
        held.high[:, 2:],
    )  # fmt: skip
    late = minimise(batch, only, iterations=_ITERATIONS)
    x[:, 2] = late.servos.values()[:, 0]
    return minimise(batch, servos.at(x), iterations=1)


def _weights(fits: Fits, lags: int) -> tuple[Array, Array]:
    """Gradient (N, 3) and curvature (N, 3, 3) of minus the log-likelihood, in units."""
    gram = fits.gram.sum(axis=1)
    variance = gram[:, 0, 0] / np.maximum(fits.count - lags, 1)
    ridge = 1e-9 * np.einsum("nff->n", gram[:, 1:, 1:])[:, None, None] * np.eye(3)
    curvature = (gram[:, 1:, 1:] + ridge) / variance[:, None, None] + 1e-30 * np.eye(3)
    return gram[:, 1:, 0] / variance[:, None], curvature


def _eliminated(weights: tuple[Array, Array]) -> tuple[Array, Array]:
    """Gradient (N, 2) and curvature (N, 2, 2) by the gains, each latency at its best."""
    slope, curvature = weights
    across = curvature[:, :2, 2] / curvature[:, 2, 2][:, None]
    inner = curvature[:, :2, :2] - across[:, :, None] * curvature[:, None, 2, :2]
    return slope[:, :2] - across * slope[:, 2:], inner


def _pooled(alone: Fits, weights: tuple[Array, Array], group: NDArray[np.intp]) -> Array:
    """Gains (N, 2) of each one's group: the mean of what each found, by how sure it is."""
    _, inner = _eliminated(weights)
    value, unit = alone.servos.values()[:, :2], alone.servos.unit[:, :2]
    out = np.empty_like(value)
    for g in np.unique(group):
        mine = group == g
        known = np.einsum("nij,nj->i", inner[mine], value[mine])
        out[mine] = np.linalg.lstsq(inner[mine].sum(axis=0), known)[0]
    return np.asarray(np.maximum(out, 1e-3) * unit)


def _step(fits: Fits, weights: tuple[Array, Array], group: NDArray[np.intp], gains: Array) -> Array:
    """Relative change of the gains, shape (N, 2), by one Gauss-Newton step of each group."""
    slope, inner = _eliminated(weights)
    out = np.empty_like(slope)
    for g in np.unique(group):
        mine = group == g
        change = np.linalg.lstsq(inner[mine].sum(axis=0), -slope[mine].sum(axis=0))[0]
        out[mine] = change / gains[mine]
    return np.clip(out, -_LARGEST_CHANGE, _LARGEST_CHANGE)


def _errors(fits: Fits, weights: tuple[Array, Array]) -> Array:
    """Standard deviation of each latency in units, were its gains known to ``GAIN_SD``."""
    _, curvature = weights
    known = curvature.copy()
    gains = np.maximum(fits.servos.values()[:, :2], 1e-9)
    known[:, [0, 1], [0, 1]] += 1 / (GAIN_SD * gains) ** 2
    return np.asarray(np.sqrt(np.linalg.inv(known)[:, 2, 2]))
