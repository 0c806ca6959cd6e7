"""The likeliest changes fitted for good: to first order one lag looks like another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sim2real.diagnose.apart import Own, fitted_apart
from sim2real.diagnose.candidates import candidate
from sim2real.diagnose.contrast import Contrast
from sim2real.diagnose.pool import Fitted, Pool
from sim2real.effects import named
from sim2real.servo.batch import Batch
from sim2real.servo.parameters import BASE, COLUMNS

Array = NDArray[np.float64]

WORTH = 3.0
"""Evidence below which nothing will be named, however well it fits."""
_BEHIND, _MOST = 6.0, 8
"""How far behind the first, and how many, are fitted."""


def sharpened(found: Contrast, pool: Pool, device: str = "cpu") -> Contrast:
    """The contrast with its likeliest changes fitted, references and case together.

    Args:
        found: What it is to first order.
        pool: What it is of.
        device: Warp device.

    Returns:
        It of these changes alone, where any is worth fitting.
    """
    evidence = found.evidence
    if pool.fitted is None or evidence.max() < WORTH:
        return found
    order = _likeliest(found.effects, evidence)
    owns, label = [_nothing()], [-1]
    for k in order:
        for own in _starts(found, int(k), pool.fitted, pool.shared):
            owns.append(own)
            label.append(int(k))
    before = list(pool.fitted.traces[: pool.references])
    batch = Batch([before, list(pool.fitted.traces[pool.references :])], device)
    fits = fitted_apart(batch, pool.fitted.servos, pool.fitted.noise, owns)
    gain = fits.loglikelihood - fits.loglikelihood[0]
    best = [max(np.flatnonzero(np.array(label) == k), key=lambda h: gain[h]) for k in order]
    loudest = found.energy / float(pool.gram[pool.references :, 0, 0].sum())
    return replace(
        found,
        effects=tuple(found.effects[k] for k in order),
        column=found.column[order],
        size=np.ones(order.size),
        gain=np.maximum(gain[best], 0.0),
        before=found.before[order],
        spread2=found.spread2[order],
        left=fits.left[best] * loudest,
        theta=fits.theta[best],
    )


def _likeliest(effects: Sequence[str], evidence: Array) -> NDArray[np.intp]:
    """Places of those that are fitted: at least one effect, whatever the plain servo explains."""
    order = np.argsort(-evidence)
    first = next(k for k in order if effects[k] not in BASE)
    near = [k for k in order[:_MOST] if evidence[k] > evidence.max() - _BEHIND and k != first]
    return np.array([first, *near])


def _nothing() -> Own:
    empty = np.zeros(0)
    return Own(np.zeros(0, dtype=np.int32), empty, empty, empty, empty)


def _starts(found: Contrast, k: int, fitted: Fitted, shared: int) -> Sequence[Own]:
    """Where the fit of a change begins: as it was looked at, and as large as it seemed to be."""
    name, column, size = found.effects[k], int(found.column[k]), float(found.size[k])
    servos = fitted.servos
    if column < shared:
        place = servos.columns[0, column]
        unit = servos.unit[0, column : column + 1]
        low, high = (x[0, column : column + 1] for x in (servos.low, servos.high))
        value = servos.theta[0, place] + size * unit
        return [Own(np.array([place]), np.clip(value, low, high), unit, low, high)]
    load = fitted.traces[0].load.inertia_kgm2
    option = candidate(named(name), float(servos.theta[0, 0]), load)
    value = fitted.rows[column, option.columns]
    given = [value]
    if "limit" not in COLUMNS[option.columns[0]]:
        larger = value.copy()
        larger[0] = np.clip(size * value[0], option.low[0], option.high[0])
        given.append(larger)
    return [Own(option.columns, v, option.unit, option.low, option.high) for v in given]
