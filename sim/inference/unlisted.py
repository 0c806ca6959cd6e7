"""Unnamed shapes of residuals, as alternatives to the effects of the catalogue.

Each family adds a few columns with a prior to those of a fit, and so has an evidence.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from itertools import product

import numpy as np
from scipy.linalg import block_diag

from sim.inference.swim_problem import Fit, SwimProblem
from sim.inference.swims import Swim
from sim2real.arrays import Array, Index
from sim2real.inference.selection import Members
from sim2real.velocity import turned

SHAPES = {
    "wave": "an oscillating flow in the pool's frame, e.g. waves",
    "gust": "a disturbance of the head for a few seconds, e.g. the wake of another swimmer",
    "bend": "poses that follow a joint, e.g. a marker that is not on the head",
    "mount": "a heading that drifts, e.g. a camera that turns",
    "change": "a change of the robot during the swim",
}
"""Families, and their possible causes."""
_WAVE_M_S = 0.03
_GUST_S, _GUST_SIZES = 1.5, (0.02, 0.02, 0.15)
_SHAKEN_HZ = (0.5, 0.8, 1.1, 1.4)
_BEND_RAD, _BEND_M = 0.2, 0.04
_MOUNT_RAD_S, _MOUNT_M_S = 0.02, 0.02
_CHANGED = ("twin.thrust", "twin.across", "twin.added_mass", "twin.along", "twin.linear")
_CHANGED_AT, _CHANGES = (0.1, 0.35, 0.5, 0.65), (1.0, 4.0)
"""Begin of the change of a robot's parameters, and its sizes in steps of each column."""


def gains(problem: SwimProblem, members: Members, fit: Fit) -> dict[str, float]:
    """Log-evidence that each shape adds to a fit, by name."""
    prior = problem.precision(members)
    inner = np.linalg.inv(fit.normal + prior)
    deviation = fit.x - problem.centre(members)
    step = inner @ (fit.slope.T @ fit.rows + prior @ deviation)
    residual = fit.rows - fit.slope @ step
    out = {}
    for name, columns in _shapes(problem, fit):
        coupling = fit.slope.T @ columns
        gradient = columns.T @ residual
        matrix = np.eye(columns.shape[1]) + columns.T @ columns - coupling.T @ inner @ coupling
        gain = 0.5 * float(gradient @ np.linalg.solve(matrix, gradient))
        out[name] = gain - 0.5 * float(np.linalg.slogdet(matrix)[1])
    return out


def _shapes(problem: SwimProblem, fit: Fit) -> Iterator[tuple[str, Array]]:
    """Columns of each shape, in prior standard deviations, weighted, (n, m); sizes of each swim."""
    shapes: dict[str, Callable[[Swim], Array]] = {"bend": _bend, "mount": _mount}
    shapes |= {f"wave {f:.2f}": partial(_wave, hertz=f) for f in np.arange(0.1, 0.84, 0.04)}
    shapes |= {f"gust {x:.1f}": partial(_gust, share=x) for x in np.arange(0.1, 1.0, 0.1)}
    parts = list(zip(problem.swims, problem.blocks, problem.weights, strict=True))
    for name, shape in shapes.items():
        columns = [blocks.weighted(shape(swim), weights) for swim, blocks, weights in parts]
        yield name, np.concatenate(columns) if name == "bend" else block_diag(*columns)
    c = problem.coordinates
    gains = [k for k, column in enumerate(c.columns) if column.kind == "servo.kp_Nm_per_rad"]
    chosen = [c.place[name] for name in _CHANGED] + gains
    steps = fit.slope[:, chosen] * c.each("step")[chosen]
    for share, slowly, factor in product(_CHANGED_AT, (False, True), _CHANGES):
        after = [
            np.repeat(_progress(b.block, share, slowly=slowly), w.shape[1]) for _, b, w in parts
        ]
        name = f"change {'since' if slowly else 'at'} {share:g} by {factor:g}"
        yield name, steps * factor * np.concatenate(after)[:, None]


def _progress(block: Index, share: float, *, slowly: bool) -> Array:
    """Share of the change that has happened at each coefficient's block, 0 to 1, shape (T,)."""
    count = int(block[-1]) + 1
    begun = round(share * count)
    if not slowly:
        return np.asarray(block >= begun, dtype=np.float64)
    return np.clip((block + 0.5 - begun) / max(count - begun, 1), 0.0, 1.0)


def _flows(swim: Swim, directions: Array) -> Array:
    """Changes of the signals by velocities (m, T, 2) in the pool's frame, shape (m, T, 3 + J)."""
    out = np.zeros((len(directions), *swim.signals.shape))
    out[..., :2] = turned(directions, -swim.heading)
    return out


def _wave(swim: Swim, hertz: float) -> Array:
    """An oscillating flow in the pool's frame."""
    angle = 2 * np.pi * hertz * swim.t
    flows = [np.outer(wave(angle), axis) for axis in np.eye(2) for wave in (np.cos, np.sin)]
    return _flows(swim, _WAVE_M_S * np.array(flows))


def _gust(swim: Swim, share: float) -> Array:
    """Oscillations of the head's velocities for a few seconds."""
    t = swim.t - share * swim.t[-1]
    envelope = np.exp(-0.5 * (t / _GUST_S) ** 2)
    out = []
    for hertz, wave, k in product(_SHAKEN_HZ, (np.cos, np.sin), range(3)):
        out.append(np.zeros(swim.signals.shape))
        out[-1][:, k] = _GUST_SIZES[k] * envelope * wave(2 * np.pi * hertz * t)
    return np.array(out)


def _bend(swim: Swim) -> Array:
    """Poses that turn, or move aside, with the angle of each joint."""
    T, K = swim.signals.shape
    signals = np.nan_to_num(swim.signals)
    surge, sway = signals[:, 0], signals[:, 1]
    out = np.zeros((2 * (K - 3), T, K))
    for j, angle in enumerate(signals[:, 3:].T):
        rate = np.gradient(angle, swim.t)
        out[2 * j, :, :3] = _BEND_RAD * np.stack([angle * sway, -angle * surge, rate], axis=1)
        out[2 * j + 1, :, 1] = _BEND_M * rate
    return out


def _mount(swim: Swim) -> Array:
    """A camera that turns at a constant rate about any point."""
    pose = np.zeros((swim.t.size, 3)) if swim.pose is None else swim.pose
    around = _MOUNT_RAD_S * np.stack([-pose[:, 1], pose[:, 0]], axis=1)
    steady = [np.tile(_MOUNT_M_S * axis, (swim.t.size, 1)) for axis in np.eye(2)]
    out = _flows(swim, np.array([around, *steady]))
    out[0, :, 2] = _MOUNT_RAD_S
    return out
