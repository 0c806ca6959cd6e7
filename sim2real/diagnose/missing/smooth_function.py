"""Physics without a name: could any smooth function of one state explain what a fit leaves?

The servo is linearised about its own motion, so that a torque on the shaft moves the angle through
1 / (I s2 + kd s + kp + gravity), and families of such torques (or of errors of the sensor) are
fitted by least squares together with the gains, the noise model with them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from sim2real.inference.correlated_noise import autoregression, lag_products, whitened
from sim2real.inference.evidence import chance_gain
from sim2real.servo.linearised import Filter, gain_torques, through, torque_filter

Array = NDArray[np.float64]


@dataclass(frozen=True)
class JointMotion:
    """One joint of one recording as a fitted servo sees it.

    Attributes:
        t: Times in s, shape (T,).
        command: Set-points in rad, shape (T,).
        angle: Simulated angle in rad, shape (T,).
        residual: Simulated minus measured angle in rad, 0 where none was measured, shape (T,).
        counts: Samples whose innovation counts, shape (T,).
        others: Simulated angles of the other joints in rad, shape (K, T).
    """

    t: Array
    command: Array
    angle: Array
    residual: Array
    counts: NDArray[np.bool_]
    others: Array


@dataclass(frozen=True)
class ServoMotion:
    """A plain servo: kp, kd, latency and stiffness of the load in SI, least noise gain."""

    kp: float
    kd: float
    latency: float
    inertia: Array
    gravity: Array
    least_gain: float
    lags: int


@dataclass(frozen=True)
class Smooth:
    """The best smooth function of one state.

    Attributes:
        state: ``position``, ``speed``, ``error``, ``time``, ``shaking``, ``other_joint``,
            ``sensor`` or ``jump``.
        gain: Log-likelihood that it gains over the plain servo, the noise model at its best.
        unknowns: Number of coefficients, the frequency of a line among them.
        jumps_s: Instant of the likeliest jump in each recording.
        shares: For each state its gain over the plain servo, less half its unknowns.
    """

    state: str
    gain: float
    unknowns: int
    jumps_s: tuple[float, ...]
    shares: dict[str, float]

    def evidence(self, count: float) -> float:
        """Evidence against the plain servo's."""
        return self.gain - chance_gain(self.unknowns, count)


def smooth_function(
    motions: Sequence[JointMotion], servo: ServoMotion, *, thorough: bool = True
) -> Smooth:
    """Find the state of which a smooth function explains most.

    Args:
        motions: The joint's recordings.
        servo: The plain servo.
        thorough: Whether to look for shaking and for jumps as well, which takes longest.
    """
    responses = [_response(m, servo, r) for r, m in enumerate(motions)]
    gains = [_gain_torques(m, servo) for m in motions]
    bent = np.vstack([through(g, f) for g, f in zip(gains, responses, strict=True)])
    plain, model = _fit(motions, bent, servo, None)
    found: dict[str, Sequence[float]] = {}
    for state, torque, sensor in _families(motions, servo):
        columns = [
            np.hstack([through(x, f), y]) for x, y, f in zip(torque, sensor, responses, strict=True)
        ]
        level, _ = _fit(motions, np.hstack([bent, np.vstack(columns)]), servo, model)
        found[state] = level, columns[0].shape[1]
    jumps: tuple[float, ...] = ()
    if thorough:
        found["shaking"] = _shaking(motions, responses, bent, servo, model)
        jumps, *found["jump"] = _jump(motions, bent, servo, model)
    state = max(found, key=lambda s: found[s][0] - 4.0 * found[s][1])
    shares = {s: x[0] - plain - 0.5 * x[1] for s, x in found.items()}
    level, unknowns = found[state]
    return Smooth(state, level - plain, int(unknowns), jumps, shares)


def smooth_function_of(given: tuple[Sequence[JointMotion], ServoMotion, bool]) -> Smooth:
    """``smooth_function`` of recordings, servo, and whether to be thorough."""
    motions, servo, thorough = given
    return smooth_function(motions, servo, thorough=thorough)


def _families(
    motions: Sequence[JointMotion], servo: ServoMotion
) -> Iterator[tuple[str, list[Array], list[Array]]]:
    """Names of states, torques (T, K) and errors of the sensor (T, K) of each recording."""
    speed = [np.gradient(m.angle, m.t) for m in motions]
    error = [m.command - m.angle for m in motions]
    none = [np.zeros((m.t.size, 0)) for m in motions]
    yield "position", _splines([m.angle for m in motions]), none
    signs = [np.tanh(v / 0.02)[:, None] for v in speed]
    rolled = _splines(speed)
    yield "speed", [np.hstack(x) for x in zip(rolled, signs, strict=True)], none
    yield "error", _splines(error), none
    yield "sensor", none, _splines([m.angle for m in motions])
    yield "time", _changing_gains(motions, servo), none
    if len({len(m.others) for m in motions}) == 1 and motions[0].others.size:
        yield (
            "other_joint",
            [np.stack([_acceleration(q, m.t) for q in m.others], axis=1) for m in motions],
            none,
        )


def _changing_gains(motions: Sequence[JointMotion], servo: ServoMotion) -> list[Array]:
    """Torques of gains and latency that drift with time, to the second order."""
    drifting = []
    for motion in motions:
        passed = ((motion.t - motion.t[0]) / (motion.t[-1] - motion.t[0]))[:, None]
        torques = _gain_torques(motion, servo)
        drifting.append(np.hstack([passed * torques, passed**2 * torques]))
    return drifting


def _splines(states: Sequence[Array], *, count: int = 8) -> list[Array]:
    """Cubic B-splines over the range of a state, for each recording (T, count)."""
    low, high = np.quantile(np.concatenate(states), [0.0, 1.0])
    inner = np.linspace(low, high + 1e-9, count - 2)
    knots = np.concatenate([[low] * 3, inner, [high + 1e-9] * 3])
    return [
        np.asarray(BSpline.design_matrix(np.clip(x, low, high), knots, 3).toarray()) for x in states
    ]


def _gain_torques(motion: JointMotion, servo: ServoMotion) -> Array:
    """Torques by which kp, kd and latency move the angle, shape (T, 3)."""
    return gain_torques(motion.t, motion.command, motion.angle, (servo.kp, servo.latency))


def _acceleration(angle: Array, t: Array) -> Array:
    return np.asarray(np.gradient(np.gradient(angle, t), t))


def _response(motion: JointMotion, servo: ServoMotion, r: int) -> Filter:
    """Filter from torque to angle at the recording's rate."""
    step = float(np.median(np.diff(motion.t)))
    return torque_filter(
        float(servo.inertia[r]), servo.kd, servo.kp + float(servo.gravity[r]), step
    )


def _fit(
    motions: Sequence[JointMotion],
    columns: Array,
    servo: ServoMotion,
    given: Array | None,
    *,
    rounds: int = 2,
) -> tuple[float, Array]:
    """Log-likelihood with these columns (N, K) and the noise model at its best, and that model."""
    cuts = np.cumsum([m.t.size for m in motions])[:-1]
    residual = np.concatenate([m.residual for m in motions])
    model = _noise_model(motions, [m.residual for m in motions], servo)
    model = model if given is None else given
    level = 0.0
    for _ in range(rounds):
        white = _whitened(motions, np.column_stack([residual, columns]), model, cuts)
        # Normalised, and with a little ridge: splines and gains overlap.
        size = np.sqrt((white[:, 1:] ** 2).sum(axis=0)) + 1e-30
        design = white[:, 1:] / size
        normal = design.T @ design + 1e-8 * np.eye(design.shape[1])
        weight = np.linalg.solve(normal, design.T @ white[:, 0]) / size
        left = residual - columns @ weight
        model = _noise_model(motions, np.split(left, cuts), servo)
        innovation = _whitened(motions, left[:, None], model, cuts)
        n = innovation.shape[0]
        level = -0.5 * n * float(np.log(np.mean(innovation**2)))
    return level, model


def _shaking(
    motions: Sequence[JointMotion],
    responses: Sequence[Filter],
    bent: Array,
    servo: ServoMotion,
    model: Array,
    *,
    shaken_Hz: tuple[float, float] = (0.2, 8.0),
    transform_length: int = 8192,
) -> tuple[float, int]:
    """A torque at one frequency, of its own phase in each recording."""
    cuts = np.cumsum([m.t.size for m in motions])[:-1]
    residual = np.concatenate([m.residual for m in motions])
    white = _whitened(motions, np.column_stack([residual, bent]), model, cuts)
    basis, _ = np.linalg.qr(white[:, 1:])
    left = white[:, 0] - basis @ (basis.T @ white[:, 0])
    power: Array = np.zeros(transform_length // 2 + 1)
    at = 0
    for motion in motions:
        n = int(motion.counts.sum())
        power += np.abs(np.fft.rfft(left[at : at + n], transform_length)) ** 2
        at += n
    hertz = np.fft.rfftfreq(transform_length, float(np.median(np.diff(motions[0].t))))
    power[(hertz < shaken_Hz[0]) | (hertz > shaken_Hz[1])] = 0.0
    lines = _lines(motions, responses, float(hertz[power.argmax()]))
    level, _ = _fit(motions, np.hstack([bent, lines]), servo, model)
    return level, lines.shape[1] + 2


def _jump(
    motions: Sequence[JointMotion],
    bent: Array,
    servo: ServoMotion,
    model: Array,
    *,
    spacing_s: float = 0.25,
) -> tuple[tuple[float, ...], float, int]:
    """A jump of the sensor's zero in each recording: the instants, log-likelihood, unknowns."""
    cuts = np.cumsum([m.t.size for m in motions])[:-1]
    residual = np.concatenate([m.residual for m in motions])
    white = _whitened(motions, np.column_stack([residual, bent]), model, cuts)
    basis, _ = np.linalg.qr(white[:, 1:])
    left = white[:, 0] - basis @ (basis.T @ white[:, 0])
    steps, instants = [], []
    for r, motion in enumerate(motions):
        edge = min(1.0, 0.1 * float(motion.t[-1] - motion.t[0]))
        times = np.arange(motion.t[0] + edge, motion.t[-1] - edge, spacing_s)
        tried = np.zeros((residual.size, times.size))
        rows = slice(*np.concatenate([[0], cuts, [residual.size]])[r : r + 2])
        tried[rows] = motion.t[:, None] >= times
        seen = _whitened(motions, tried, model, cuts)
        seen -= basis @ (basis.T @ seen)
        best = int(((seen.T @ left) ** 2 / ((seen**2).sum(axis=0) + 1e-30)).argmax())
        steps.append(tried[:, best])
        instants.append(float(times[best]))
    columns = np.column_stack(steps)
    level, _ = _fit(motions, np.hstack([bent, columns]), servo, model)
    return tuple(instants), level, 3 * len(motions)


def _lines(motions: Sequence[JointMotion], responses: Sequence[Filter], frequency: float) -> Array:
    """Responses to a sine and a cosine, in columns of their own for each recording."""
    blocks = []
    for r, (motion, filtered) in enumerate(zip(motions, responses, strict=True)):
        phase = 2 * np.pi * frequency * motion.t
        wave = through(np.stack([np.sin(phase), np.cos(phase)], axis=1), filtered)
        block = np.zeros((motion.t.size, 2 * len(motions)))
        block[:, 2 * r : 2 * r + 2] = wave
        blocks.append(block)
    return np.vstack(blocks)


def _whitened(
    motions: Sequence[JointMotion], columns: Array, model: Array, cuts: NDArray[np.intp]
) -> Array:
    """Innovations of columns (N, K) at the samples that count."""
    parts = [whitened(part, model, axis=0) for part in np.split(columns, cuts)]
    return np.vstack([x[m.counts] for x, m in zip(parts, motions, strict=True)])


def _noise_model(
    motions: Sequence[JointMotion], residuals: Sequence[Array], servo: ServoMotion
) -> Array:
    pairs = zip(motions, residuals, strict=True)
    products = np.sum([lag_products(x, m.counts, servo.lags) for m, x in pairs], axis=0)
    return np.asarray(autoregression(products[None], servo.least_gain)[0])
