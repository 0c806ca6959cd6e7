"""What no catalogue has, as shapes without a name: is what is left of a swim one of them?

Each family is a handful of columns beside the fit's own, with a prior, and so has an evidence: a
flow that changes in the world's frame (waves, a gust), poses that follow a joint (a marker that is
not on the head), a heading that drifts (a mount), a robot that becomes another one half-way (a
leak, a part that comes loose). They are hypotheses against which the catalogue's have to stand, and
no findings.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from sim.inference.blocks import Blocks, spectrum
from sim.inference.swims import Swim
from sim.inference.twin_search import Fit, TwinSwims
from sim2real.inference.selection import Members

Array = NDArray[np.float64]

_WAVES_HZ = tuple(float(f) for f in np.arange(0.1, 0.84, 0.04))
_WAVE_M_S = 0.03
_GUSTS = tuple(float(x) for x in np.arange(0.1, 1.0, 0.1))
_GUST_S, _GUST_M_S, _GUST_RAD_S = 1.5, 0.02, 0.15
_SHAKEN_HZ = (0.5, 0.8, 1.1, 1.4)
_BEND_RAD, _BEND_M = 0.2, 0.04
_MOUNT_RAD_S, _MOUNT_M_S = 0.02, 0.02
_OTHER = ("twin.thrust", "twin.across", "twin.added_mass", "twin.along", "twin.linear")
_OTHERWISE = (1.0, 4.0)
"""How far a robot that became another is from what it was, in steps of each column."""


def gains(problem: TwinSwims, members: Members, fit: Fit) -> dict[str, float]:
    """Evidence that each family adds to a fit, by its name."""
    rows, slope = problem.part(fit)
    prior = problem.precision(members)
    inner = np.linalg.inv(slope.T @ slope + prior)
    off = fit.x - problem.centre(members)
    best = rows - slope @ (inner @ (slope.T @ rows + prior @ off))
    out = {}
    for name, columns in _families(problem, fit):
        Z = columns if problem.kept is None else columns[problem.kept]
        across = slope.T @ Z
        left = Z.T @ Z - across.T @ inner @ across
        pull = Z.T @ best
        matrix = np.eye(Z.shape[1]) + left
        gain = 0.5 * float(pull @ np.linalg.solve(matrix, pull))
        out[name] = gain - 0.5 * float(np.linalg.slogdet(matrix)[1])
    return out


def _families(problem: TwinSwims, fit: Fit) -> Iterator[tuple[str, Array]]:
    """Columns of each family, in prior standard deviations, weighted, shape (n, m)."""
    swims = list(zip(problem.swims, problem.blocks, problem.weights, strict=True))
    for hertz in _WAVES_HZ:
        yield f"wave {hertz:.2f}", _stacked([_weighed(_wave(s, hertz), b, w) for s, b, w in swims])
    for share in _GUSTS:
        yield f"gust {share:.1f}", _stacked([_weighed(_gust(s, share), b, w) for s, b, w in swims])
    yield "bend", _stacked([_weighed(_bend(s), b, w) for s, b, w in swims], shared=True)
    yield "mount", _stacked([_weighed(_mount(s), b, w) for s, b, w in swims])
    c = problem.coordinates
    chosen = [c.place[name] for name in _OTHER] + [
        k for k, column in enumerate(c.columns) if column.kind == "servo.kp_Nm_per_rad"
    ]
    size = np.array([c.columns[k].step for k in chosen])
    for share in (0.1, 0.35, 0.5, 0.65):
        for slowly in (False, True):
            late = np.concatenate([
                np.repeat(_later(b, share, slowly=slowly), w.shape[1]) for _, b, w in swims
            ])  # fmt: skip
            for far in _OTHERWISE:
                name = f"change {'since' if slowly else 'at'} {share:g} by {far:g}"
                yield name, fit.near.slope[:, chosen] * far * size * late[:, None]


def _later(blocks: Blocks, share: float, *, slowly: bool) -> Array:
    """How far a robot has become another by each coefficient's block, 0 to 1, shape (T,)."""
    count = len(blocks.edges)
    begun = round(share * count)
    if not slowly:
        return np.asarray(blocks.block >= begun, dtype=np.float64)
    return np.clip((blocks.block + 0.5 - begun) / max(count - begun, 1), 0.0, 1.0)


def _stacked(parts: list[Array], *, shared: bool = False) -> Array:
    """Columns of several swims: each its own, or the same in all."""
    if shared or len(parts) == 1:
        return np.concatenate(parts)
    out = np.zeros((sum(len(p) for p in parts), sum(p.shape[1] for p in parts)))
    row = column = 0
    for p in parts:
        out[row : row + len(p), column : column + p.shape[1]] = p
        row, column = row + len(p), column + p.shape[1]
    return out


def _weighed(signals: Array, blocks: Blocks, weights: Array) -> Array:
    """Columns (m, T, K) of signals as a fit counts them, shape (T K, m)."""
    return np.asarray((spectrum(signals, blocks.edges) * weights).reshape(len(signals), -1).T)


def _wave(swim: Swim, hertz: float) -> Array:
    """A flow to and fro in the pool's frame."""
    angle = 2 * np.pi * hertz * swim.t
    wave = np.stack([np.cos(angle), np.sin(angle)])
    c, s = np.cos(swim.heading), np.sin(swim.heading)
    out = np.zeros((4, *swim.signals.shape))
    out[:2, :, 0], out[:2, :, 1] = c * wave, -s * wave
    out[2:, :, 0], out[2:, :, 1] = s * wave, c * wave
    return _WAVE_M_S * out


def _gust(swim: Swim, share: float) -> Array:
    """The head shaken for a while."""
    t = swim.t - share * swim.t[-1]
    near = np.exp(-0.5 * (t / _GUST_S) ** 2)
    out = np.zeros((6 * len(_SHAKEN_HZ), *swim.signals.shape))
    for n, hertz in enumerate(_SHAKEN_HZ):
        for m, wave in enumerate((np.cos, np.sin)):
            shaken = near * wave(2 * np.pi * hertz * t)
            for k, size in enumerate((_GUST_M_S, _GUST_M_S, _GUST_RAD_S)):
                out[6 * n + 3 * m + k, :, k] = size * shaken
    return out


def _bend(swim: Swim) -> Array:
    T, K = swim.signals.shape
    signals = np.nan_to_num(swim.signals)
    surge, sway = signals[:, 0], signals[:, 1]
    out = np.zeros((2 * (K - 3), T, K))
    for j in range(K - 3):
        angle = signals[:, 3 + j]
        rate = np.gradient(angle, swim.t)
        turned, moved = out[2 * j], out[2 * j + 1]
        turned[:, 0], turned[:, 1], turned[:, 2] = angle * sway, -angle * surge, rate
        moved[:, 1] = rate
        out[2 * j] *= _BEND_RAD
        out[2 * j + 1] *= _BEND_M
    return out


def _mount(swim: Swim) -> Array:
    """A camera that turns about some place, and goes on."""
    out = np.zeros((3, *swim.signals.shape))
    c, s = np.cos(swim.heading), np.sin(swim.heading)
    out[0, :, 2] = _MOUNT_RAD_S
    if swim.pose is not None:
        x, y = _MOUNT_RAD_S * swim.pose[:, :2].T
        out[0, :, 0], out[0, :, 1] = s * x - c * y, c * x + s * y
    out[1, :, 0], out[1, :, 1] = _MOUNT_M_S * c, -_MOUNT_M_S * s
    out[2, :, 0], out[2, :, 1] = _MOUNT_M_S * s, _MOUNT_M_S * c
    return out


__all__ = ["gains"]
