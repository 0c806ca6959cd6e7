"""A rival: sparse regression of the torque that the plain servo lacks."""

from __future__ import annotations

import warnings

import numpy as np
from rival_case import Array, Case, Said, entry
from rival_torque import Residual, State, lacking_torque, predicted

from sim2real.identification.fit import Fit
from sim2real.servo.trace import Trace

THRESHOLDS, RIDGE = (1.6, 0.8, 0.4, 0.2, 0.1, 0.05), 0.05
"""Of the sparse regression; of terms in units of their own and the residual's spread."""
NO_BETTER = 0.97
"""A lower threshold is taken if it leaves less than so much of the error on the other recording."""
TERMS: dict[str, tuple[str, Residual]] = {
    "error": ("", lambda s: s.error),
    "speed": ("", lambda s: s.v),
    "sign v": ("coulomb_friction", lambda s: np.tanh(s.v / 0.05)),
    "sign v, slow": (
        "stribeck_friction", lambda s: np.tanh(s.v / 0.05) * np.exp(-((s.v / 0.4) ** 2)),
    ),
    "|torque| sign v": ("load_friction", lambda s: np.abs(s.torque) * np.tanh(s.v / 0.05)),
    "|v| v": ("quadratic_drag", lambda s: np.abs(s.v) * s.v),
    "sin q": ("gravity_load", lambda s: np.sin(s.q)),
    "1": ("sensor_offset", lambda s: np.ones_like(s.q)),
    "acceleration": ("unmodelled_inertia", lambda s: s.acceleration),
    "|torque|": ("torque_asymmetry", lambda s: np.abs(s.torque)),
    "torque³": ("torque_saturation", lambda s: s.torque**3),
    "small error": ("deadband", lambda s: np.clip(s.error, -0.02, 0.02)),
    "integral": ("integral_action", lambda s: s.wound),
    "torque t": ("supply_droop", lambda s: s.torque * s.t),
}  # fmt: skip
"""Terms of the library: the effect that each is taken for, and its value."""


def sparse_regression(case: Case) -> Said:
    """SINDy of the torque that the plain servo lacks (Brunton et al., PNAS 113 (2016) 3932).

    Its terms come without probabilities: those that stay are taken as claims.
    """
    entries, weights = [], {}
    for joint, some in case.given.items():
        first, *others = [_regressors([one], case.plain[joint]) for one in some]
        found = _solved(*first, THRESHOLDS[0])
        for threshold in THRESHOLDS[1:]:
            trial = _solved(*first, threshold)
            if _left(trial, others or [first]) < NO_BETTER * _left(found, others or [first]):
                found = trial
        weights[joint] = found
        size = np.abs(found) * np.sqrt(np.mean(first[0] ** 2, axis=0))
        kept = {n: x for (n, _), x in zip(TERMS.values(), size, strict=True) if n and x > 0}
        entries += [(x, entry(name, joint, 1.0, {})) for name, x in kept.items()]
    joints = list(case.given)
    scales = np.stack([weights[joint] for joint in joints])

    def residual(state: State) -> Array:
        values = np.stack([value(state) for _, value in TERMS.values()], axis=1)
        return np.asarray((values * scales).sum(axis=1))

    ordered = tuple(entry for _, entry in sorted(entries, key=lambda pair: -pair[0]))
    return Said(ordered, case.model, predicted(case, residual))


def _regressors(some: list[Trace], plain: Fit) -> tuple[Array, Array]:
    """Values of all terms, shape (n, terms), and the torque to explain, shape (n,)."""
    states, lacking = lacking_torque(some, plain)
    return np.stack([value(states) for _, value in TERMS.values()], axis=1), lacking


def _solved(columns: Array, lacking: Array, threshold: float) -> Array:
    """Sequentially thresholded least squares: a coefficient for each term."""
    from pysindy import STLSQ

    spread, unit = np.sqrt(np.mean(columns**2, axis=0)), lacking.std()
    spread[spread < 1e-12] = 1.0
    solver = STLSQ(threshold=threshold, alpha=RIDGE * lacking.size)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that nothing is left is an answer
        solver.fit(columns / spread, (lacking / unit)[:, None])
    return np.asarray(solver.coef_).ravel() / spread * unit


def _left(found: Array, others: list[tuple[Array, Array]]) -> float:
    errors = [lacking - columns @ found for columns, lacking in others]
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))
