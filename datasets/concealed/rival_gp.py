"""A rival: the torque that the plain servo lacks, by a Gaussian process."""

from __future__ import annotations

import warnings

import numpy as np
from rival_case import Array, Case, Said
from rival_torque import State, lacking_torque, predicted

POINTS = 300
"""Samples of each joint."""


def gaussian_process(case: Case) -> Said:
    """The torque that the plain servo lacks, as any smooth function of angle, speed and error."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    centres, lengths, weights, units = [], [], [], []
    rng = np.random.default_rng(0)
    for joint, some in case.given.items():
        states, lacking = lacking_torque(some, case.plain[joint])
        chosen = rng.choice(lacking.size, min(POINTS, lacking.size), replace=False)
        points = _features(states)
        size, unit = points.std(axis=0), lacking.std()
        kernel = ConstantKernel(0.5) * RBF([1.0, 1.0, 1.0], (0.1, 100.0)) + WhiteKernel(0.5)
        process = GaussianProcessRegressor(kernel)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # an input that does not matter
            process.fit((points / size)[chosen], lacking[chosen] / unit)
        fitted = process.kernel_.k1
        centres.append(process.X_train_)
        lengths.append(np.broadcast_to(fitted.k2.length_scale, 3))
        weights.append(process.alpha_.ravel() * fitted.k1.constant_value * unit)
        units.append(size)
    X, alpha = np.stack(centres), np.stack(weights)
    length, size = np.stack(lengths)[:, None], np.stack(units)

    def residual(state: State) -> Array:
        apart = ((_features(state) / size)[:, None] - X) / length
        return np.asarray((np.exp(-0.5 * (apart**2).sum(axis=2)) * alpha).sum(axis=1))

    return Said((), case.model, predicted(case, residual))


def _features(state: State) -> Array:
    return np.stack([state.q, state.v, state.error], axis=1)
