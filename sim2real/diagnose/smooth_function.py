"""Physics without a name: could any smooth function of one state explain what a fit leaves?

The servo is linearised about its own motion: a torque on the shaft moves the angle through
1 / (I s2 + kd s + kp + gravity). Families of such torques, or of errors of the sensor, are fitted
by least squares together with the gains and the noise model.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import block_diag
from scipy.signal import lfilter

from sim2real.arrays import Array, Mask
from sim2real.inference.correlated_noise import autoregression, lag_products, whitened
from sim2real.inference.evidence import chance_gain
from sim2real.servo.trace import Trace


@dataclass(frozen=True)
class JointMotion:
    """One joint of one recording as a fitted servo sees it."""

    trace: Trace  # the recording, of T samples
    angle: Array  # simulated angle in rad, shape (T,)
    residual: Array  # simulated minus measured angle in rad, 0 where none was measured, shape (T,)
    counts: Mask  # samples whose innovation counts, shape (T,)
    others: Array  # simulated angles of the other joints in rad, shape (K, T)


@dataclass(frozen=True)
class ServoMotion:
    """A plain servo, its recordings, and what its noise may be."""

    motions: Sequence[JointMotion]  # its recordings
    kp: float  # proportional gain, N m/rad
    kd: float  # derivative gain, N m s/rad
    latency: float  # latency, s
    least_gain: float  # smallest gain of the noise's whitening filter
    lags: int  # samples that the noise remembers
    thorough: bool = True  # whether to look for shaking and for jumps as well, which takes longest


@dataclass(frozen=True)
class Smooth:
    """The best smooth function of one state."""

    # ``position``, ``speed``, ``error``, ``time``, ``shaking``, ``other_joint``, ``sensor`` or
    # ``jump``
    state: str
    gain: float  # log-likelihood that it gains over the plain servo, the noise model at its best
    unknowns: int  # number of coefficients, the frequency of a line among them
    jumps_s: tuple[float, ...]  # instant of the most probable jump in each recording
    shares: dict[str, float]  # for each state its gain over the plain servo, less half its unknowns

    def evidence(self, count: float) -> float:
        """Evidence against the plain servo's."""
        return self.gain - chance_gain(self.unknowns, count)


def smooth_function(servo: ServoMotion) -> Smooth:
    """Find the state of which a smooth function explains most of the residuals of a servo."""
    problem = _Regression(servo)
    plain, model = problem.fit(np.zeros((problem.residual.size, 0)), None)
    levels: dict[str, float] = {}
    unknowns: dict[str, int] = {}
    for state, columns in _families(problem):
        levels[state], _ = problem.fit(columns, model)
        unknowns[state] = columns.shape[1]
    jumps: tuple[float, ...] = ()
    if servo.thorough:
        lines = _shaking(problem, model)
        jumps, steps = _jumps(problem, model)
        unknowns |= {"shaking": lines.shape[1] + 2, "jump": 3 * len(jumps)}
        for name, columns in (("shaking", lines), ("jump", steps)):
            levels[name], _ = problem.fit(columns, model)
    state = max(levels, key=lambda s: levels[s] - 4.0 * unknowns[s])
    shares = {s: level - plain - 0.5 * unknowns[s] for s, level in levels.items()}
    return Smooth(state, levels[state] - plain, unknowns[state], jumps, shares)


class _Regression:
    """Least squares on the residuals of a joint, with its gains and its noise model."""

    def __init__(self, servo: ServoMotion) -> None:
        self.servo, self.motions = servo, servo.motions
        self.cuts = np.cumsum([m.residual.size for m in self.motions])[:-1]
        self.residual = np.concatenate([m.residual for m in self.motions])
        self.filters = [_torque_filter(servo, m.trace) for m in self.motions]
        self.torques = [_gain_torques(servo, m) for m in self.motions]
        self.gains = self.angles(self.torques)

    def angles(self, torques: Sequence[Array]) -> Array:
        """Angles by which torques (T, K) in each recording move the servo, shape (N, K)."""
        return np.vstack(
            [lfilter(*f, x, axis=0) for x, f in zip(torques, self.filters, strict=True)]
        )

    def fit(self, columns: Array, model: Array | None, *, rounds: int = 2) -> tuple[float, Array]:
        """Log-likelihood with gains, columns (N, K) and noise model at their best; the model."""
        columns = np.hstack([self.gains, columns])
        model = self._noise_model(self.residual) if model is None else model
        level = 0.0
        for _ in range(rounds):
            white = self.whitened(np.column_stack([self.residual, columns]), model)
            # Normalised, and with a little ridge: splines and gains overlap.
            size = np.sqrt((white[:, 1:] ** 2).sum(axis=0)) + 1e-30
            design = white[:, 1:] / size
            normal = design.T @ design + 1e-8 * np.eye(design.shape[1])
            weight = np.linalg.solve(normal, design.T @ white[:, 0]) / size
            left = self.residual - columns @ weight
            model = self._noise_model(left)
            innovation = self.whitened(left[:, None], model)
            level = -0.5 * len(innovation) * float(np.log(np.mean(innovation**2)))
        return level, model

    def without_gains(self, model: Array) -> tuple[Array, Array]:
        """Innovations that the gains leave, and an orthonormal basis of what they take up."""
        white = self.whitened(np.column_stack([self.residual, self.gains]), model)
        basis, _ = np.linalg.qr(white[:, 1:])
        return white[:, 0] - basis @ (basis.T @ white[:, 0]), basis

    def whitened(self, columns: Array, model: Array) -> Array:
        """Innovations of columns (N, K) at the samples that count."""
        parts = zip(self.motions, np.split(columns, self.cuts), strict=True)
        return np.vstack(
            [whitened(m.trace.standardised(x), model, axis=0)[m.counts] for m, x in parts]
        )

    def _noise_model(self, residual: Array) -> Array:
        pairs = zip(self.motions, np.split(residual, self.cuts), strict=True)
        lags = self.servo.lags
        products = np.sum(
            [lag_products(m.trace.standardised(x), m.counts, lags) for m, x in pairs], axis=0
        )
        return np.asarray(autoregression(products[None], self.servo.least_gain)[0])


def _torque_filter(servo: ServoMotion, trace: Trace) -> tuple[Array, Array]:
    """Digital filter from torque in N m to angle in rad, 1 / (I s2 + kd s + stiffness).

    By the bilinear transform: Oppenheim, Schafer, Discrete-Time Signal Processing, 3rd ed. (Pearson
    2010), section 7.2.2. Numerator and denominator are as ``scipy.signal.lfilter`` takes them.
    """
    inertia, kd = trace.load.inertia_kgm2, servo.kd
    stiffness = trace.gain_factor * servo.kp + trace.load.gravity_Nm
    c = 2 / trace.period_s
    a = inertia * c**2 * np.array([1, -2, 1]) + kd * c * np.array([1, 0, -1])
    a += stiffness * np.array([1, 2, 1])
    return np.array([1.0, 2.0, 1.0]) / a[0], a / a[0]


def _gain_torques(servo: ServoMotion, motion: JointMotion) -> Array:
    """Torques equivalent to a change of kp, kd and latency, per unit of each, shape (T, 3)."""
    trace, t, angle = motion.trace, motion.trace.t, motion.angle
    in_force = np.interp(t + trace.sample_delay_s - servo.latency, t, trace.command)
    torques = [in_force - angle, np.gradient(angle, t), servo.kp * np.gradient(in_force, t)]
    return np.stack(torques, axis=1) * [trace.gain_factor, 1.0, trace.gain_factor]


def _families(problem: _Regression) -> Iterator[tuple[str, Array]]:
    """Names of states, and the angles that smooth functions of each make, shape (N, K)."""
    motions = problem.motions
    position = _splines([m.angle for m in motions])
    speed = [np.gradient(m.angle, m.trace.t) for m in motions]
    signs = [np.tanh(v / 0.02)[:, None] for v in speed]
    yield "position", problem.angles(position)
    yield "speed", problem.angles([np.hstack(x) for x in zip(_splines(speed), signs, strict=True)])
    yield "error", problem.angles(_splines([m.trace.command - m.angle for m in motions]))
    yield "sensor", np.vstack(position)
    drifting = []  # gains and latency that change with time, to the second order
    for motion, torques in zip(motions, problem.torques, strict=True):
        t = motion.trace.t
        passed = ((t - t[0]) / (t[-1] - t[0]))[:, None]
        drifting.append(np.hstack([passed * torques, passed**2 * torques]))
    yield "time", problem.angles(drifting)
    if len({len(m.others) for m in motions}) == 1 and motions[0].others.size:
        accelerations = [
            np.stack([np.gradient(np.gradient(q, m.trace.t), m.trace.t) for q in m.others], axis=1)
            for m in motions
        ]
        yield "other_joint", problem.angles(accelerations)


def _splines(states: Sequence[Array], *, count: int = 8) -> list[Array]:
    """Cubic B-splines over the range of a state, for each recording (T, count)."""
    low, high = np.quantile(np.concatenate(states), [0.0, 1.0])
    inner = np.linspace(low, high + 1e-9, count - 2)
    knots = np.concatenate([[low] * 3, inner, [high + 1e-9] * 3])
    return [
        np.asarray(BSpline.design_matrix(np.clip(x, low, high), knots, 3).toarray()) for x in states
    ]


def _shaking(
    problem: _Regression,
    model: Array,
    *,
    shaken_Hz: tuple[float, float] = (0.2, 8.0),
    transform_length: int = 8192,
) -> Array:
    """Angles of torques at the best frequency, a sine and a cosine for each recording."""
    motions = problem.motions
    left, _ = problem.without_gains(model)
    ends = np.cumsum([int(motion.counts.sum()) for motion in motions])[:-1]
    power: Array = np.zeros(transform_length // 2 + 1)
    for part in np.split(left, ends):
        power += np.abs(np.fft.rfft(part, transform_length)) ** 2
    hertz = np.fft.rfftfreq(transform_length, motions[0].trace.period_s)
    power[(hertz < shaken_Hz[0]) | (hertz > shaken_Hz[1])] = 0.0
    blocks = []
    for motion, filtered in zip(motions, problem.filters, strict=True):
        phase = 2 * np.pi * float(hertz[power.argmax()]) * motion.trace.t
        wave = np.stack([np.sin(phase), np.cos(phase)], axis=1)
        blocks.append(lfilter(*filtered, wave, axis=0))
    return block_diag(*blocks)


def _jumps(
    problem: _Regression, model: Array, *, spacing_s: float = 0.25
) -> tuple[tuple[float, ...], Array]:
    """The best instant at which the sensor's zero jumps in each recording, and the steps."""
    left, basis = problem.without_gains(model)
    size = problem.residual.size
    edges = [0, *problem.cuts, size]
    steps, instants = [], []
    for r, motion in enumerate(problem.motions):
        t = motion.trace.t
        edge = min(1.0, 0.1 * float(t[-1] - t[0]))
        times = np.arange(t[0] + edge, t[-1] - edge, spacing_s)
        tried = np.zeros((size, times.size))
        tried[edges[r] : edges[r + 1]] = t[:, None] >= times
        seen = problem.whitened(tried, model)
        seen -= basis @ (basis.T @ seen)
        best = int(((seen.T @ left) ** 2 / ((seen**2).sum(axis=0) + 1e-30)).argmax())
        steps.append(tried[:, best])
        instants.append(float(times[best]))
    return tuple(instants), np.column_stack(steps)
