"""Residuals of swims: unnamed shapes, as alternatives to effects, and where in the motion they are.

A shape adds a few columns with a prior to those of a fit, and so has an evidence. Residuals are in
standard deviations of the noise and of the simulator's usual error, transformed back to time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np
from scipy.linalg import block_diag
from scipy.ndimage import uniform_filter1d

from sim.inference.signal_error import SLOW
from sim.inference.swim_problem import Fit, SwimProblem
from sim.inference.swims import Swim
from sim.robot.swimmer import CONTROL_S
from sim2real.arrays import Array, Mask
from sim2real.inference.segments import Window, most_uneven, robust_sd, windows
from sim2real.inference.selection import Members
from sim2real.units import three_digits
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


def residuals(problem: SwimProblem, rows: Array) -> list[Array]:
    """Residuals of each swim in standard deviations, (T, 3 + J), from rows (n,) of a fit."""
    pairs = zip(problem.blocks, problem.of_swims(rows), strict=True)
    return [blocks.in_time(part) for blocks, part in pairs]


def located(swims: Sequence[Swim], square: Array, signal: int) -> tuple[str, str]:
    """Part of the motion in which squared residuals (n,) of a signal are, and what to record.

    It has at least as many as 40 % of them in a quarter of the time.
    """
    part = most_uneven(square, _parts(swims, signal), least=0.05)
    if part is None:
        return "throughout the motion", "Record longer swims with other strokes"
    return str(part), part.advice


def windows_of(swims: Sequence[Swim], residual: Sequence[Array]) -> dict[str, tuple[Window, ...]]:
    """Times of large residuals (T,) of each swim, beyond their usual size and beyond noise."""
    pairs = zip(swims, residual, strict=True)
    sizes = [max(1.0, robust_sd(one, np.zeros(one.size, dtype=bool))) for one in residual]
    return {s.name: windows(s.t, one, sd) for (s, one), sd in zip(pairs, sizes, strict=True)}


def _parts(swims: Sequence[Swim], signal: int) -> Iterator[tuple[str, Mask, str]]:
    """Parts of the motion of a joint, or of the last and the body: words, samples, advice."""

    def of_all(signal: int) -> tuple[Array, Array]:
        """Swing and slow part of a signal in all swims."""
        whole = [np.nan_to_num(swim.signals[:, signal]) for swim in swims]
        slow = [uniform_filter1d(x, SLOW, mode="nearest") for x in whole]
        return np.concatenate(whole) - np.concatenate(slow), np.concatenate(slow)

    t = np.concatenate([swim.t for swim in swims])
    yield "in the first 2 s", t < 2.0, "Record the start from rest several times"
    k = signal if signal > 2 else swims[0].signals.shape[1] - 1
    (swing, _), joint = of_all(k), k - 2
    rate = np.concatenate([np.gradient(np.nan_to_num(s.signals[:, k]), CONTROL_S) for s in swims])
    rest = 0.05 * float(np.quantile(np.abs(rate), 0.99))
    moves = np.abs(rate) > rest
    yield f"while joint {joint} rests", ~moves, "Record pauses and glides between strokes"
    # phase of the stroke: angle and rate in units of their root mean squares
    far, fast = (np.abs(x) / max(float(np.sum(x[moves] ** 2)) ** 0.5, 1e-9) for x in (swing, rate))
    advice = "Record strokes of several amplitudes at one beat"
    yield f"at the ends of the stroke of joint {joint}", moves & (far > fast), advice
    yield f"in the middle of the stroke of joint {joint}", moves & (far <= fast), advice
    mirrored = "Record the same swim mirrored"
    yield f"while joint {joint} turns to positive angles", rate > rest, mirrored
    yield f"while joint {joint} turns to negative angles", rate < -rest, mirrored
    (_, surge), (_, turning) = of_all(0), of_all(2)
    yield "in turns to the left", turning > np.quantile(np.abs(turning), 0.5), mirrored
    yield "in turns to the right", turning < -np.quantile(np.abs(turning), 0.5), mirrored
    far_off = np.nan_to_num(np.hypot(*np.concatenate([s.pose for s in swims])[:, :2].T))
    states = (
        ("times", "s", t, "Record the same swim again, and a longer one"),
        (f"rates of joint {joint}", "rad/s", np.abs(rate), "Record beats of several frequencies"),
        ("speeds", "m/s", surge, "Record steady swims at several speeds"),
        ("rates of turning", "rad/s", np.abs(turning), "Record circles of several radii"),
        ("distances from the pool's origin", "m", far_off, "Record swims all over the pool"),
    )
    for name, unit, state, advice in states[: 2 if signal > 2 else None]:
        for level in np.quantile(state, (0.25, 0.5, 0.75, 0.9)).tolist():
            edge = f"{three_digits(level)} {unit}"
            yield f"at {name} above {edge}", state > level, advice
            yield f"at {name} below {edge}", state <= level, advice
