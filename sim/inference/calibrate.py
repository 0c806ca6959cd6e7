"""Fit the body, and the servos with it, to swims in a pool.

Least squares on surge, sway, yaw rate and joint angles, each weighted by what is left of it after a
first fit. Its residuals are correlated in time and hold what the simulator lacks, so the intervals
come from the scores' own scatter between blocks of two seconds (the sandwich of White, Econometrica
48 (1980) 817, in blocks), not from a likelihood that would count each sample as news. Derivatives
are central differences, all simulations of a step in one launch.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.optimize import least_squares
from scipy.stats import norm

from sim.inference.swims import Simulator, Swim, simulated, with_values
from sim.twin.twin import FITTED
from sim2real.body import body_effect
from sim2real.model import Model
from sim2real.robot import Robot

Array = NDArray[np.float64]

HELD_OUT_SHARE = 1 / 3
"""Share of a recording, at its end, that the fit does not see."""
BLOCK = 100
"""Samples of a block: two seconds, a beat or more."""
_ROUNDS = 2
_LEVEL = 0.9
_STEP = 0.05
"""Step of the derivatives, in the parameters' sizes."""


@dataclass(frozen=True)
class Free:
    """A parameter that is fitted.

    Attributes:
        name: As ``with_values`` takes it.
        start: Where the search begins.
        size: What a person would call a change; the step of the derivatives is a twentieth.
        low, high: Its bounds.
        prior_sd: Standard deviation of its normal prior about ``start``.
    """

    name: str
    start: float
    size: float
    low: float
    high: float
    prior_sd: float


@dataclass(frozen=True)
class Calibrated:
    """What a calibration found.

    Attributes:
        model: The calibrated model.
        free: What was fitted.
        best: Its values, shape (F,).
        sd: Their standard deviations, shape (F,).
        rmse: Root mean square error of each signal on what was held out, before and after, shape
            (2, 3 + J), or (2, K) of another view.
        train: Likewise on what was fitted.
    """

    model: Model
    free: tuple[Free, ...]
    best: Array
    sd: Array
    rmse: Array
    train: Array

    def interval(self, level: float = _LEVEL) -> Array:
        """Central intervals, shape (F, 2)."""
        reach = float(norm.ppf(0.5 + level / 2)) * self.sd
        return np.stack([self.best - reach, self.best + reach], axis=1)


_LEAST = {"across": 1.0, "along": 0.2, "added_mass": 0.2, "linear": 0.2}
"""What counts as a usual value of a coefficient where the fitted one is smaller."""


def law_parameters() -> list[Free]:
    """The twin's own law, each within a factor of a few of what the fluid gave.

    The wake differs most from one water to another. The others (``slender``, ``head`` and so on)
    stay as the fluid gave them: a few swims cannot tell them from these, and would hide an effect
    behind them.
    """
    out = []
    for name, least in _LEAST.items():
        value = float(getattr(FITTED, name))
        usual = max(value, least)
        out.append(Free(f"twin.{name}", value, 0.5 * usual, 0.05 * value, 20 * usual, 2 * usual))
    return [
        *out,
        Free("twin.thrust", FITTED.thrust, 0.1, 0.0, 2.0, 0.5),
        Free("twin.wake", FITTED.wake, 0.1, 0.0, 0.95, 0.3),
        Free("twin.wake_s", FITTED.wake_s, 0.3 * FITTED.wake_s, 0.05, 10.0, FITTED.wake_s),
    ]


def servo_parameters(model: Model, robot: Robot, *, gains: bool = False) -> list[Free]:
    """Latencies of all joints, and their gains if asked.

    The bench gives gains better than a swim does, where the water that goes along hides them; the
    latency may be another by radio.
    """
    out = []
    names = ("kp_Nm_per_rad", "kd_Nms_per_rad", "latency_s") if gains else ("latency_s",)
    for joint in robot.joints:
        servo = model.joints[joint.name]
        for name in names:
            value = float(getattr(servo, name))
            size = max(abs(value), 1e-3)
            sd = 0.5 if name == "latency_s" else 0.1
            full = f"{joint.name}.{name}"
            out.append(Free(full, value, 0.2 * size, 0.05 * size, 20 * size, sd * size))
    return out


def body_parameters(robot: Robot) -> list[Free]:
    """What a plain simulator may have wrong about the body; nothing that a diagnosis would name."""
    out = effect_parameters("form_drag") + effect_parameters("linear_drag")
    for material in sorted({link.material or "" for link in robot.links}):
        out += effect_parameters("surface_friction", material)
    return out + effect_parameters("added_mass") + effect_parameters("com_offset")


def effect_parameters(effect: str, material: str | None = None) -> list[Free]:
    """Parameters of a body or camera effect."""
    known = body_effect(effect)
    prefix = f"{effect}.{material}" if known.by_material else effect
    out = []
    for k, p in enumerate(known.parameters):
        start = 0.0 if k == 0 or p.low < 0 else p.typical
        start = max(start, p.low)
        out.append(Free(f"{prefix}.{p.name}", start, p.typical, p.low, p.high, 4 * p.typical))
    return out


def calibrate(
    swims: Sequence[Swim],
    model: Model,
    free: Sequence[Free],
    simulator: Simulator,
    *,
    held_out: float = HELD_OUT_SHARE,
    evaluations: int = 12,
    view: Callable[[Array], Array] = lambda signals: signals,
    progress: Callable[[float], None] = lambda share: None,
) -> Calibrated:
    """Fit parameters to the first part of each swim and score them on the rest.

    Args:
        swims: Recordings.
        model: Where to start.
        free: What to fit.
        simulator: The twin or the fluid.
        held_out: Share of each swim at its end that is held out.
        evaluations: Most steps of each round.
        view: What of the signals (..., T, 3 + J) is compared, shape (..., T, K).
        progress: Called with the share that is done.
    """
    free = tuple(free)
    F = len(free)
    size = np.array([p.size for p in free])
    start = np.array([p.start for p in free])
    low, high = (np.array([getattr(p, end) for p in free]) / size for end in ("low", "high"))
    center, spread = start / size, np.array([p.prior_sd for p in free]) / size
    cut = [round(swim.t.size * (1 - held_out)) for swim in swims]

    def errors(points: Array) -> list[Array]:
        models = [
            with_values(model, {p.name: float(v) for p, v in zip(free, x * size, strict=True)})
            for x in points
        ]
        return [
            np.nan_to_num(view(simulated(swim, models, simulator) - swim.signals), nan=1e3)
            for swim in swims
        ]

    before = errors(center[None])
    weight = 1 / _rmse(before, cut, held=False)[0]
    x = np.clip(center, low, high)
    for done in range(_ROUNDS):

        def residual(point: Array, by: Array = weight) -> Array:
            return np.concatenate(
                [_fitted(errors(point[None]), by, cut)[0], (point - center) / spread]
            )

        def slope(point: Array, by: Array = weight) -> Array:
            ahead, back = np.minimum(point + _STEP, high), np.maximum(point - _STEP, low)
            own = np.eye(F, dtype=bool)
            points = np.concatenate([np.where(own, ahead, point), np.where(own, back, point)])
            moved = _fitted(errors(points), by, cut)
            change = (moved[:F] - moved[F:]) / (ahead - back)[:, None]
            return np.concatenate([change.T, np.diag(1 / spread)])

        inside = np.clip(x, low + 1e-9, high - 1e-9)
        found = least_squares(
            residual, inside, slope, bounds=(low, high), max_nfev=evaluations, x_scale="jac"
        )
        x = found.x
        progress((done + 1) / _ROUNDS)
        if done < _ROUNDS - 1:
            weight = 1 / _rmse(errors(x[None]), cut, held=False)[0]
    after = errors(x[None])
    best = x * size
    return Calibrated(
        model=with_values(model, {p.name: float(v) for p, v in zip(free, best, strict=True)}),
        free=free,
        best=best,
        sd=_sandwich(np.asarray(found.jac), np.asarray(found.fun), F, len(weight), cut) * size,
        rmse=np.concatenate([_rmse(e, cut, held=True) for e in (before, after)]),
        train=np.concatenate([_rmse(e, cut, held=False) for e in (before, after)]),
    )


def seen(signals: Array) -> Array:
    """Signals (..., T, 3 + J) with the means of the first three over two seconds beside them."""
    slow = uniform_filter1d(signals[..., :3], BLOCK, axis=-2, mode="nearest")
    return np.concatenate([signals, slow], axis=-1)


def _fitted(errors: list[Array], weight: Array, cut: list[int]) -> Array:
    """Weighted errors of the fitted part, swim by swim, sample by sample, shape (E, all)."""
    rows = [
        (error[:, :end] * weight).reshape(len(error), -1)
        for error, end in zip(errors, cut, strict=True)
    ]
    return np.concatenate(rows, axis=1)


def _rmse(errors: list[Array], cut: list[int], *, held: bool) -> Array:
    """Root mean square error of each signal over all swims, shape (E, 3 + J)."""
    parts = [e[:, end:] if held else e[:, :end] for e, end in zip(errors, cut, strict=True)]
    return np.asarray(np.sqrt(np.mean(np.concatenate(parts, axis=1) ** 2, axis=1)))


def _sandwich(jacobian: Array, residual: Array, free: int, signals: int, cut: list[int]) -> Array:
    """Standard deviations from the scatter of the scores between blocks, shape (F,)."""
    bread = np.linalg.inv(jacobian.T @ jacobian)
    score = (jacobian * residual[:, None])[: -free or None]
    meat, at, blocks = np.zeros((free, free)), 0, 0
    for end in cut:
        one = score[at : at + end * signals].reshape(end, signals, free).sum(axis=1)
        at += end * signals
        for k in range(0, end, BLOCK):
            g = one[k : k + BLOCK].sum(axis=0)
            meat += np.outer(g, g)
            blocks += 1
    prior = jacobian[-free:]
    meat = meat * blocks / max(blocks - 1, 1) + prior.T @ prior
    return np.asarray(np.sqrt(np.diag(bread @ meat @ bread)))
