"""Unnamed shapes of residuals, as alternatives to the effects of the catalogue.

A shape adds a few columns with a prior to those of a fit, and so has an evidence.
"""

from collections.abc import Iterator
from itertools import product

import numpy as np
from scipy.linalg import block_diag

from sim.inference.swim_problem import Fit, SwimProblem
from sim.inference.swims import Swim
from sim2real.arrays import Array
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
_CHANGED = ("twin.thrust", "twin.across", "twin.added_mass", "twin.along", "twin.linear")
"""Parameters of a robot that may change, besides the gains of its servos."""


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
    parts = list(zip(problem.blocks, problem.weights, strict=True))
    of_swims = [_unnamed(swim) for swim in problem.swims]
    for name in of_swims[0]:
        columns = [b.weighted(of[name], w) for of, (b, w) in zip(of_swims, parts, strict=True)]
        yield name, np.concatenate(columns) if name == "bend" else block_diag(*columns)
    c = problem.coordinates
    servos = [k for k, column in enumerate(c.columns) if column.kind == "servo.kp_Nm_per_rad"]
    chosen = [c.place[name] for name in _CHANGED] + servos
    steps = fit.slope[:, chosen] * c.each("step")[chosen]
    for share, slowly, factor in product((0.1, 0.35, 0.5, 0.65), (False, True), (1.0, 4.0)):
        after = []
        for blocks, weights in parts:
            count = int(blocks.block[-1]) + 1
            begun = round(share * count)
            grown = np.clip((blocks.block + 0.5 - begun) / max(count - begun, 1), 0.0, 1.0)
            done = grown if slowly else (blocks.block >= begun).astype(np.float64)
            after.append(np.repeat(done, weights.shape[1]))
        name = f"change {'since' if slowly else 'at'} {share:g} by {factor:g}"
        yield name, steps * factor * np.concatenate(after)[:, None]


def _unnamed(swim: Swim) -> dict[str, Array]:
    """Changes of the signals by shapes outside the robot, of usual sizes, (m, T, 3 + J) by name."""
    signals, heading, (T, K) = np.nan_to_num(swim.signals), swim.heading, swim.signals.shape

    def flows(velocities: Array) -> Array:
        """Changes by velocities (m, T, 2) in the pool's frame."""
        out = np.zeros((len(velocities), T, K))
        out[..., :2] = turned(velocities, -heading)
        return out

    bend = np.zeros((2 * (K - 3), T, K))  # poses that turn, or move aside, with each joint's angle
    for j, angle in enumerate(signals[:, 3:].T):
        rate = np.gradient(angle, swim.t)
        turning = np.stack([angle * signals[:, 1], -angle * signals[:, 0], rate], axis=1)
        bend[2 * j, :, :3], bend[2 * j + 1, :, 1] = 0.2 * turning, 0.04 * rate
    around = 0.02 * np.stack([-swim.pose[:, 1], swim.pose[:, 0]], axis=1)
    mount = flows(np.array([around, *(np.tile(0.02 * axis, (T, 1)) for axis in np.eye(2))]))
    mount[0, :, 2] = 0.02
    out = {"bend": bend, "mount": mount}
    for hertz in np.arange(0.1, 0.84, 0.04):
        angle = 2 * np.pi * hertz * swim.t
        waves = [np.outer(wave(angle), axis) for axis in np.eye(2) for wave in (np.cos, np.sin)]
        out[f"wave {hertz:.2f}"] = flows(0.03 * np.array(waves))
    shaken = list(product((0.5, 0.8, 1.1, 1.4), (np.cos, np.sin), enumerate((0.02, 0.02, 0.15))))
    for share in np.arange(0.1, 1.0, 0.1):
        t = swim.t - share * swim.t[-1]
        gust = np.zeros((len(shaken), T, K))
        for column, (hertz, wave, (k, size)) in zip(gust, shaken, strict=True):
            column[:, k] = size * np.exp(-0.5 * (t / 1.5) ** 2) * wave(2 * np.pi * hertz * t)
        out[f"gust {share:.1f}"] = gust
    return out
