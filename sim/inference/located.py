"""Where simulated and recorded swims differ: in which signals, when, in which part of the motion.

Residuals are in standard deviations of the noise and of the simulator's usual error, transformed
back to time.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.ndimage import uniform_filter1d

from sim.inference.signal_error import SLOW
from sim.inference.swim_problem import SwimProblem
from sim.inference.swims import Swim
from sim.robot.swimmer import CONTROL_S
from sim2real.arrays import Array, Mask
from sim2real.inference.segments import Window, most_uneven, robust_sd, windows
from sim2real.units import three_digits


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
