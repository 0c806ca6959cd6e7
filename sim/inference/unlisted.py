"""Unnamed shapes of residuals, as alternatives to the effects of the catalogue.

Each family adds a few columns with a prior to those of a fit, and so has an evidence: a flow that
changes in the world frame (waves, a gust), poses that follow a joint (a marker that is not on the
head), a heading that drifts (a camera mount), a robot whose parameters change during a swim (a
leak, a loose part). They are not findings, but effects of the catalogue must fit better than they.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sim.inference.blocks import Blocks, spectrum
from sim.inference.swims import Swim
from sim.inference.twin_search import Fit, TwinSwims
from sim2real.arrays import Array
from sim2real.inference.selection import Members

_WAVES_HZ = tuple(float(f) for f in np.arange(0.1, 0.84, 0.04))
_WAVE_M_S = 0.03
_GUSTS = tuple(float(x) for x in np.arange(0.1, 1.0, 0.1))
_GUST_S, _GUST_M_S, _GUST_RAD_S = 1.5, 0.02, 0.15
_SHAKEN_HZ = (0.5, 0.8, 1.1, 1.4)
_BEND_RAD, _BEND_M = 0.2, 0.04
_MOUNT_RAD_S, _MOUNT_M_S = 0.02, 0.02
_CHANGED = ("twin.thrust", "twin.across", "twin.added_mass", "twin.along", "twin.linear")
_CHANGES = (1.0, 4.0)
"""Sizes of the change of a robot's parameters, in steps of each column."""


def gains(problem: TwinSwims, members: Members, fit: Fit) -> dict[str, float]:
    """Log-evidence that each family adds to a fit, by name."""
    rows, slope = problem.part(fit)
    prior = problem.precision(members)
    inner = np.linalg.inv(slope.T @ slope + prior)
    deviation = fit.x - problem.centre(members)
    residual = rows - slope @ (inner @ (slope.T @ rows + prior @ deviation))
    out = {}
    for name, columns in _families(problem, fit):
        used = columns if problem.kept is None else columns[problem.kept]
        coupling = slope.T @ used
        curvature = used.T @ used - coupling.T @ inner @ coupling
        gradient = used.T @ residual
        matrix = np.eye(used.shape[1]) + curvature
        gain = 0.5 * float(gradient @ np.linalg.solve(matrix, gradient))
        out[name] = gain - 0.5 * float(np.linalg.slogdet(matrix)[1])
    return out


def _families(problem: TwinSwims, fit: Fit) -> Iterator[tuple[str, Array]]:
    """Columns of each family, in prior standard deviations, weighted, shape (n, m)."""
    swims = list(zip(problem.swims, problem.blocks, problem.weights, strict=True))
    for hertz in _WAVES_HZ:
        yield f"wave {hertz:.2f}", _stacked([_weighted(_wave(s, hertz), b, w) for s, b, w in swims])
    for share in _GUSTS:
        yield f"gust {share:.1f}", _stacked([_weighted(_gust(s, share), b, w) for s, b, w in swims])
    yield "bend", _stacked([_weighted(_bend(s), b, w) for s, b, w in swims], shared=True)
    yield "mount", _stacked([_weighted(_mount(s), b, w) for s, b, w in swims])
    c = problem.coordinates
    chosen = [c.place[name] for name in _CHANGED] + [
        k for k, column in enumerate(c.columns) if column.kind == "servo.kp_Nm_per_rad"
    ]
    size = np.array([c.columns[k].step for k in chosen])
    for share in (0.1, 0.35, 0.5, 0.65):
        for slowly in (False, True):
            share_after = np.concatenate([
                np.repeat(_progress(b, share, slowly=slowly), w.shape[1]) for _, b, w in swims
            ])  # fmt: skip
            for factor in _CHANGES:
                name = f"change {'since' if slowly else 'at'} {share:g} by {factor:g}"
                yield name, fit.near.slope[:, chosen] * factor * size * share_after[:, None]


def _progress(blocks: Blocks, share: float, *, slowly: bool) -> Array:
    """Share of the change that has happened at each coefficient's block, 0 to 1, shape (T,)."""
    count = len(blocks.edges)
    begun = round(share * count)
    if not slowly:
        return np.asarray(blocks.block >= begun, dtype=np.float64)
    return np.clip((blocks.block + 0.5 - begun) / max(count - begun, 1), 0.0, 1.0)


def _stacked(parts: list[Array], *, shared: bool = False) -> Array:
    """Columns of several swims: separate for each swim, or shared by all."""
    if shared or len(parts) == 1:
        return np.concatenate(parts)
    out = np.zeros((sum(len(part) for part in parts), sum(part.shape[1] for part in parts)))
    row = column = 0
    for part in parts:
        out[row : row + len(part), column : column + part.shape[1]] = part
        row, column = row + len(part), column + part.shape[1]
    return out


def _weighted(signals: Array, blocks: Blocks, weights: Array) -> Array:
    """Columns (m, T, K) of signals, transformed and weighted as in a fit, shape (T K, m)."""
    return np.asarray((spectrum(signals, blocks.edges) * weights).reshape(len(signals), -1).T)


def _wave(swim: Swim, hertz: float) -> Array:
    """An oscillating flow in the pool's frame."""
    angle = 2 * np.pi * hertz * swim.t
    wave = np.stack([np.cos(angle), np.sin(angle)])
    c, s = np.cos(swim.heading), np.sin(swim.heading)
    out = np.zeros((4, *swim.signals.shape))
    out[:2, :, 0], out[:2, :, 1] = c * wave, -s * wave
    out[2:, :, 0], out[2:, :, 1] = s * wave, c * wave
    return _WAVE_M_S * out


def _gust(swim: Swim, share: float) -> Array:
    """Oscillations of the head's velocities for a few seconds."""
    t = swim.t - share * swim.t[-1]
    envelope = np.exp(-0.5 * (t / _GUST_S) ** 2)
    out = np.zeros((6 * len(_SHAKEN_HZ), *swim.signals.shape))
    for n, hertz in enumerate(_SHAKEN_HZ):
        for m, wave in enumerate((np.cos, np.sin)):
            oscillation = envelope * wave(2 * np.pi * hertz * t)
            for k, size in enumerate((_GUST_M_S, _GUST_M_S, _GUST_RAD_S)):
                out[6 * n + 3 * m + k, :, k] = size * oscillation
    return out


def _bend(swim: Swim) -> Array:
    T, K = swim.signals.shape
    signals = np.nan_to_num(swim.signals)
    surge, sway = signals[:, 0], signals[:, 1]
    out = np.zeros((2 * (K - 3), T, K))
    for j in range(K - 3):
        angle = signals[:, 3 + j]
        rate = np.gradient(angle, swim.t)
        rotation, displacement = out[2 * j], out[2 * j + 1]
        rotation[:, 0], rotation[:, 1], rotation[:, 2] = angle * sway, -angle * surge, rate
        displacement[:, 1] = rate
        out[2 * j] *= _BEND_RAD
        out[2 * j + 1] *= _BEND_M
    return out


def _mount(swim: Swim) -> Array:
    """A camera that turns at a constant rate about any point."""
    out = np.zeros((3, *swim.signals.shape))
    c, s = np.cos(swim.heading), np.sin(swim.heading)
    out[0, :, 2] = _MOUNT_RAD_S
    if swim.pose is not None:
        x, y = _MOUNT_RAD_S * swim.pose[:, :2].T
        out[0, :, 0], out[0, :, 1] = s * x - c * y, c * x + s * y
    out[1, :, 0], out[1, :, 1] = _MOUNT_M_S * c, -_MOUNT_M_S * s
    out[2, :, 0], out[2, :, 1] = _MOUNT_M_S * s, _MOUNT_M_S * c
    return out
