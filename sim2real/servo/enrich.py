"""Fit effects of the catalogue together with the gains that would otherwise hide them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sim2real.effects import Effect, Parameter
from sim2real.servo.fit import Fit, robust_loss, robust_scale, search
from sim2real.servo.parameters import BASE, COLUMNS
from sim2real.servo.rollout import STEPS_PER_RADIAN, rollout
from sim2real.servo.start import natural_units
from sim2real.servo.symbolic import PARAMETERS
from sim2real.servo.trace import Trace

Array = NDArray[np.float64]

STRENGTHS = (0.3, 1.0, 3.0, 10.0)
"""Multiples of the typical value from which each parameter of an effect starts."""
_MOST_STARTS = 256
_DIFFERENCE = 1e-4
"""Step of the central differences, in natural units."""
_THREADS = 2


def fit_effects(traces: Sequence[Trace], plain: Fit, effects: Sequence[Effect]) -> Fit:
    """Fit gains, latency and the parameters of effects to all traces at once.

    Derivatives are central differences, all of them and the point itself in one batch of rollouts.
    Every parameter of an effect starts from several strengths, so that none is lost at zero.

    Args:
        traces: The joint's recordings.
        plain: The fit without them. What it knows of a motor stays as it is.
        effects: What to add to it.

    Returns:
        The fit; its parameters are those of ``plain`` and then those of the effects, named
        ``effect.parameter``.
    """
    given = _parameters(plain, effects)
    names = (*plain.names, *given)
    columns = [*range(3), *(COLUMNS.index(name) for name in given)]
    free = (0, 1, 2, *range(len(plain.names), len(names)))
    row = _row(plain)
    low = np.array([*plain.low, *(p.low for p in given.values())])
    high = np.array([*plain.high, *(p.high for p in given.values())])
    index, unit = list(free), effect_units(plain, effects)
    substep_s = _substep(plain)

    def evaluate(x: Array) -> tuple[Array, Array]:
        shifts = _DIFFERENCE * np.vstack([np.zeros(x.size), np.eye(x.size), -np.eye(x.size)])
        angles = _simulate(traces, (x + shifts) * unit, columns, substep_s, row)
        errors = np.concatenate([_error(a[0], t) for a, t in zip(angles, traces, strict=True)])
        up, down = (
            np.concatenate(
                [a[part][:, t.used] for a, t in zip(angles, traces, strict=True)], axis=1
            )
            for part in (slice(1, x.size + 1), slice(x.size + 1, None))
        )
        return errors, (up - down).T / (2 * _DIFFERENCE)

    box = (low[index] / unit, high[index] / unit)
    tried = [
        search(evaluate, np.clip(start / unit, *box), box, rounds=0, evaluations=12)[0]
        for start in _starts(traces, plain, given, columns, substep_s, row)
    ]
    nearest = min(tried, key=lambda x: robust_loss([evaluate(x)[0]], plain.scale_rad))
    x, converged = search(evaluate, nearest, box, rounds=3, evaluations=40)
    errors, slopes = evaluate(x)
    parameters = np.append(plain.parameters, np.zeros(len(given)))
    parameters[index] = x * unit
    cuts = np.cumsum([np.count_nonzero(t.used) for t in traces])[:-1]
    return Fit(
        names=names,
        parameters=parameters,
        low=low,
        high=high,
        free=free,
        scale_rad=robust_scale(errors),
        residuals=tuple(np.split(errors, cuts)),
        jacobians=tuple(np.split(slopes / unit, cuts)),
        converged=converged,
        inertia=plain.inertia,
    )


def residuals_with_effects(fit: Fit, traces: Sequence[Trace]) -> tuple[Array, ...]:
    """Simulated minus measured angle at the used samples of each trace, for a fit with effects."""
    angles = _simulate(traces, fit.parameters[None, :3], [0, 1, 2], _substep(fit), _row(fit))
    return tuple(_error(a[0], t) for a, t in zip(angles, traces, strict=True))


def _row(fit: Fit) -> Array:
    """The row of a rollout with everything that the fit knows but its load, shape (P,)."""
    row = np.zeros(len(COLUMNS))
    row[[COLUMNS.index(name) for name in fit.names[len(PARAMETERS) :]]] = fit.parameters[
        len(PARAMETERS) :
    ]
    return row


def _parameters(plain: Fit, effects: Sequence[Effect]) -> dict[str, Parameter]:
    """Every parameter of the effects, scaled to this servo, by its column's name."""
    kp = float(plain.parameters[0])
    return {
        f"{effect.name}.{p.name}": p.scaled(kp, plain.inertia)
        for effect in effects
        for p in effect.parameters
    }


def effect_units(plain: Fit, effects: Sequence[Effect]) -> Array:
    """A natural size of each free parameter of a fit with effects, shape (F,)."""
    given = _parameters(plain, effects).values()
    own = natural_units(plain.parameters, plain.inertia)[:3]
    return np.array([*own, *(p.typical or p.high / 10 for p in given)])


def _substep(fit: Fit) -> float:
    """One sub-step for all rows, fine enough for gains half as large again."""
    kp, kd = 1.5 * fit.parameters[:2]
    fastest = max(np.sqrt(kp / fit.inertia), 0.5 * kd / fit.inertia)
    return float(min(0.002, 1 / (2 * STEPS_PER_RADIAN * fastest)))


def _starts(
    traces: Sequence[Trace],
    plain: Fit,
    given: dict[str, Parameter],
    columns: list[int],
    substep_s: float,
    row: Array,
) -> Array:
    """For each strength of each parameter the combination that fits best, gains as fitted."""
    choices = [[min(max(s * p.typical, p.low), p.high) for s in STRENGTHS] for p in given.values()]
    every = len(STRENGTHS) ** len(choices) <= _MOST_STARTS
    grid = np.array(
        list(itertools.product(*choices)) if every else list(zip(*choices, strict=True))
    )
    rows = np.hstack([np.tile(plain.parameters[:3], (grid.shape[0], 1)), grid])
    angles = _simulate(traces, rows, columns, substep_s, row)
    losses = [
        robust_loss([_error(a[k], t) for a, t in zip(angles, traces, strict=True)], plain.scale_rad)
        for k in range(rows.shape[0])
    ]
    order = np.argsort(losses)
    best = {
        int(next(k for k in order if grid[k, column] == value))
        for column in range(grid.shape[1])
        for value in np.unique(grid[:, column])
    }
    return np.asarray(rows[sorted(best)])


def _simulate(
    traces: Sequence[Trace], values: Array, columns: list[int], substep_s: float, row: Array
) -> list[Array]:
    """Angles of servos as ``row`` but ``values`` (B, F) in ``columns``, each trace (B, T)."""
    angles = []
    for trace in traces:
        theta = np.tile(row, (values.shape[0], 1))
        theta[:, BASE.index("inertia_kgm2")] = trace.load.inertia_kgm2
        theta[:, BASE.index("gravity_Nm")] = trace.load.gravity_Nm
        theta[:, columns] = values
        command = trace.command[:, None]
        angles.append(
            rollout(theta, trace.t, command, substep_s=substep_s, threads=_THREADS)[:, :, 0]
        )
    return angles


def _error(angle: Array, trace: Trace) -> Array:
    return np.asarray((angle - trace.position)[trace.used])
