"""Search for the effects that are missing in swims, unnamed shapes, and where residuals are.

A shape adds a few columns with a prior to those of a fit, and so has an evidence. Residuals are in
standard deviations of the noise and of the simulator's usual error, transformed back to time.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import block_diag
from scipy.ndimage import uniform_filter1d

from sim.inference.coordinates import is_shown, signals_of
from sim.inference.signal_error import SLOW, kinds_of
from sim.inference.swim_problem import COST, LOST, Fit, SwimPrior, SwimProblem
from sim.inference.swims import Swim
from sim.robot.swimmer import CONTROL_S
from sim2real.arrays import Array, Mask
from sim2real.body import listed, values
from sim2real.inference.segments import Window, most_uneven, robust_sd, windows
from sim2real.inference.selection import Breadth, Hypothesis, Ledger, Members, select
from sim2real.model import Model
from sim2real.progress import Progress
from sim2real.units import three_digits
from sim2real.velocity import turned

HELD_OUT = 0.3
"""Share of each swim, at its end, on which predictions are compared."""
_SHARE, _LATE_S = 0.1, 0.01
"""Relative error, and delay in s, of the change that an effect makes."""
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


class HeldOutErrors(NamedTuple):
    """A fit to the beginning of swims, its loss on their end, and its error of the speed there."""

    fit: Fit
    loss: float
    speed: float


@dataclass(frozen=True)
class Searched:
    """Result of a search, before decisions."""

    problem: SwimProblem  # the swims
    found: dict[Members, Hypothesis[Fit]]  # every set that was tried, best first
    plain: Hypothesis[Fit]  # the fit without effects
    best: Hypothesis[Fit]  # the best set with an effect, likely or not
    held: dict[Members, HeldOutErrors]  # held-out errors of each subset of the best that was tried
    # the input of ``swim_decision.decide``, from which thresholds are fitted, in types of JSON: the
    # evidence of each set, that of unnamed shapes beside the plain fit and the best, held-out
    # errors, and the mean square of the best fit's weighted errors by signal and band, less the
    # estimated error of the twin (4, 3)
    raw: dict[str, Any]


def searched(
    problem: SwimProblem,
    progress: Progress = lambda share: None,
    simulated: Model | None = None,
    *,
    referred: bool = False,
) -> Searched:
    """Try sets of effects on swims of one robot, with a prior from ``learned``.

    The twin predicts a strong effect with an error in proportion to its change; a second search
    counts it as noise, except for effects of ``simulated``, the model that the fluid simulated.
    ``referred``: the prior has reference swims.
    """
    found = _search(problem, lambda share: progress(0.5 * share))
    if "water" in problem.coordinates.model.body:
        best = next(h for h in found if h.members)
        changes = changed(problem, best.fit.x, simulated)
        parts = zip(changes, problem.blocks, problem.weights, strict=True)
        size = sum(float(np.sum(b.about(change) * w**2)) for change, b, w in parts)
        if 0.5 * _SHARE**2 * size > 3.0:  # log-evidence from which such an error counts as noise
            problem = replace(problem, prior=doubtful(problem, changes))
            found = _search(problem, lambda share: progress(0.5 + 0.4 * share))
    tried = {hypothesis.members: hypothesis for hypothesis in found}
    plain, best = tried[frozenset()], next(h for h in found if h.members)
    held = {s: _held_out(problem, tried[s]) for s in _subsets(best.members) if s in tried}
    sets = [
        {"names": sorted(map(list, h.members)), "settled": h.fit.local,
         "evidence": h.evidence + COST * len(h.members) - plain.evidence}
        for h in found
    ]  # fmt: skip
    raw = {
        "sets": sets,
        "nameless": {
            name: gains(problem, h.members, h.fit) for name, h in (("plain", plain), ("best", best))
        },
        "held": [
            {"names": sorted(map(list, members)), "loss": errors.loss, "speed": errors.speed}
            for members, errors in held.items()
        ],
        "misfit": problem.misfit(best.members, best.fit).tolist(),
        "referred": referred,
        "repeated": problem.repeated,
    }
    progress(1.0)
    return Searched(problem, tried, plain, best, held, raw)


def _search(problem: SwimProblem, progress: Progress) -> list[Hypothesis[Fit]]:
    """Every set that was tried, of at most two effects besides lost frames, best first."""
    ledger: Ledger[Fit] = Ledger(0)
    ledger.keep(problem.plain())
    progress(0.1)
    lost = LOST in problem.coordinates.effects and problem.counted(frozenset({LOST})) > 0
    breadth = Breadth(most=2 + lost, added=5, rivals=3, within=np.inf)
    select(problem, [ledger], breadth, lambda share: progress(0.1 + 0.5 * share))
    for subset in _subsets(ledger.best.members)[1:-1]:  # another start, another minimum
        for hypothesis in problem.refit([(ledger, subset, problem.start(ledger, subset))]):
            ledger.keep(hypothesis)
    first, *others = sorted((h for h in ledger.tried.values() if h.members), key=_evidence)
    near = [h.members for h in others[:4] if h.evidence > first.evidence - 10.0]
    # those near the best are fitted until new derivatives hardly change their loss
    for members in {*near, *_subsets(first.members)[1:]} & ledger.tried.keys():
        for _ in range(3):
            fit = ledger.tried[members].fit
            ledger.tried[members] = problem.refined(members, fit, fit)
            if abs(fit.loss - ledger.tried[members].fit.loss) < 0.7:
                break
    progress(1.0)
    return sorted(ledger.tried.values(), key=_evidence)


def _evidence(hypothesis: Hypothesis[Fit]) -> float:
    """Key to sort by, best first."""
    return -hypothesis.evidence


def _subsets(members: Members) -> list[Members]:
    """Every subset of a set, the empty set first, the set itself last."""
    effects = sorted(members)
    return [frozenset(s) for n in range(len(effects) + 1) for s in combinations(effects, n)]


def changed(problem: SwimProblem, x: Array, simulated: Model | None = None) -> list[Array]:
    """Change of each swim's signals by the effects at a point (F,), in the twin, (T, 3 + J)."""
    c = problem.coordinates
    full, base = c.model_at(x), c.model_at(np.where(c.in_fit(frozenset()), x, c.nominal))
    kept = {name: v for name, v in values(full).items() if is_shown(name)}
    kept |= values(simulated) if simulated else {}
    joints = full.joints if simulated else base.joints
    without = replace(full, joints=joints, body={**full.body, "effects": listed(kept)})
    pairs = (signals_of([full, without], swim, problem.simulate) for swim in problem.swims)
    return [with_effects - bare for with_effects, bare in pairs]


def doubtful(problem: SwimProblem, changes: Sequence[Array]) -> SwimPrior:
    """The prior with larger errors of the simulator, in proportion to these changes."""
    recorded, prior = [swim.signals for swim in problem.swims], problem.prior
    size, of_signal = (
        np.sqrt(np.nanmean(np.concatenate(x) ** 2, axis=0)) for x in (changes, recorded)
    )
    ratio = np.nan_to_num(size / of_signal)
    sd = {
        name: (_LATE_S if kind == "late" else _SHARE) * float(ratio[k])
        for name, (k, kind) in kinds_of(size.size - 3).items()
        if not kind.startswith("off")
    }
    more = np.array([sd.get(column.name, 0.0) for column in problem.coordinates.columns])
    covariance = prior.covariance + np.diag(more**2)
    shares = np.hypot(prior.shares, _SHARE * np.append(ratio[:3], ratio[3:].mean())[:, None])
    return SwimPrior(prior.mean, covariance, np.hypot(prior.imitation, more), shares)


def _held_out(problem: SwimProblem, hypothesis: Hypothesis[Fit]) -> HeldOutErrors:
    """Held-out errors of a set on the end of the swims, fitted to their beginning."""
    fit, left_out = problem.held(hypothesis.members, hypothesis.fit, HELD_OUT)
    rows = np.where(left_out, problem.rows(fit.x[None])[0], 0.0)
    square, count = 0.0, 0
    parts = problem.of_swims(rows), problem.of_swims(left_out.astype(np.float64)), problem.weights
    for error, left, weight in zip(*parts, strict=True):
        square += float(np.sum((error[:, :2] / weight[:, :2]) ** 2))
        count += int(left[:, 0].sum())
    return HeldOutErrors(fit, 0.5 * float(rows @ rows), float(np.sqrt(square / max(count, 1))))


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
