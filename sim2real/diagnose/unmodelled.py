"""Where and when something is missing, and whether it is in the catalogue at all.

Could any smooth function of one state explain what a fit leaves? Families of torques, which move
the linearised servo through 1 / (I s2 + kd s + kp + gravity), or of errors of the sensor are fitted
by least squares together with the gains and the noise model.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import block_diag
from scipy.signal import lfilter

from sim2real.arrays import Array, Mask
from sim2real.diagnose.decision import DECISION
from sim2real.identification.servo_problem import Fits, minimise, residual_angles
from sim2real.inference.correlated_noise import (
    RESIDUAL_WANDER,
    autoregression,
    lag_products,
    whitened,
)
from sim2real.inference.segments import Window, inside, robust_sd, windows
from sim2real.progress import shared
from sim2real.servo.batch import Batch
from sim2real.servo.trace import FINEST_NOISE_RAD, Trace

Windows = tuple[tuple[Window, ...], ...]
_NOWHERE: tuple[Windows | None, float] = (None, -np.inf)


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
    """A plain servo, its recordings of N samples in all, and what its noise may be."""

    motions: Sequence[JointMotion]  # its recordings
    kp: float  # proportional gain, N m/rad
    kd: float  # derivative gain, N m s/rad
    latency: float  # latency, s
    least_gain: float  # smallest gain of the noise's whitening filter
    lags: int  # samples that the noise remembers
    thorough: bool = True  # whether to look for shaking and for jumps as well, which takes longest

    @cached_property
    def residual(self) -> Array:
        """Simulated minus measured angle of all recordings in rad, shape (N,)."""
        return np.concatenate([m.residual for m in self.motions])

    @cached_property
    def filters(self) -> list[tuple[Array, Array]]:
        """Digital filters from torque in N m to angle in rad, 1 / (I s2 + kd s + stiffness).

        By the bilinear transform: Oppenheim, Schafer, Discrete-Time Signal Processing, 3rd ed.
        (Pearson 2010), section 7.2.2. One a recording, as ``scipy.signal.lfilter`` takes them.
        """
        filters = []
        for trace in (m.trace for m in self.motions):
            stiffness = trace.gain_factor * self.kp + trace.load.gravity_Nm
            c = 2 / trace.period_s
            a = trace.load.inertia_kgm2 * c**2 * np.array([1, -2, 1])
            a += self.kd * c * np.array([1, 0, -1]) + stiffness * np.array([1, 2, 1])
            filters.append((np.array([1.0, 2.0, 1.0]) / a[0], a / a[0]))
        return filters

    @cached_property
    def gain_torques(self) -> list[Array]:
        """Torques equivalent to a change of kp, kd and latency, per unit of each, (T, 3) each."""
        torques = []
        for m in self.motions:
            t, ratio = m.trace.t, m.trace.gain_factor
            in_force = np.interp(t + m.trace.sample_delay_s - self.latency, t, m.trace.command)
            rates = np.gradient(m.angle, t), self.kp * np.gradient(in_force, t)
            torques.append(np.stack([in_force - m.angle, *rates], axis=1) * [ratio, 1.0, ratio])
        return torques

    @cached_property
    def gain_angles(self) -> Array:
        """Angles by which these move the servo, shape (N, 3)."""
        return self.angles(self.gain_torques)

    def angles(self, torques: Sequence[Array]) -> Array:
        """Angles by which torques (T, K) in each recording move the servo, shape (N, K)."""
        pairs = zip(self.filters, torques, strict=True)
        return np.vstack([lfilter(*f, x, axis=0) for f, x in pairs])

    def fit(self, columns: Array, model: Array | None, *, rounds: int = 2) -> tuple[float, Array]:
        """Log-likelihood with gains, columns (N, K) and noise model at their best; the model."""
        columns = np.hstack([self.gain_angles, columns])
        model = self._noise_model(self.residual) if model is None else model
        level = 0.0
        for _ in range(rounds):
            white = self.whitened(np.column_stack([self.residual, columns]), model)
            # Normalised, and with a little ridge: splines and gains overlap.
            size = np.sqrt((white[:, 1:] ** 2).sum(axis=0)) + 1e-30
            design = white[:, 1:] / size
            normal = design.T @ design + 1e-8 * np.eye(design.shape[1])
            solution = np.linalg.solve(normal, design.T @ white[:, 0])
            left = self.residual - columns @ (solution / size)
            model = self._noise_model(left)
            innovation = self.whitened(left[:, None], model)
            level = -0.5 * len(innovation) * float(np.log(np.mean(innovation**2)))
        return level, model

    def without_gains(self, model: Array) -> tuple[Array, Array]:
        """Innovations that the gains leave, and an orthonormal basis of what they take up."""
        white = self.whitened(np.column_stack([self.residual, self.gain_angles]), model)
        basis, _ = np.linalg.qr(white[:, 1:])
        return white[:, 0] - basis @ (basis.T @ white[:, 0]), basis

    def whitened(self, columns: Array, model: Array) -> Array:
        """Innovations of columns (N, K) at the samples that count."""
        parts = self.by_motion(columns)
        return np.vstack(
            [whitened(m.trace.standardised(x), model, axis=0)[m.counts] for m, x in parts]
        )

    def by_motion(self, values: Array) -> Iterator[tuple[JointMotion, Array]]:
        """The recordings, each with its part of values (N, ...)."""
        cuts = np.cumsum([m.residual.size for m in self.motions])[:-1]
        return zip(self.motions, np.split(values, cuts), strict=True)

    def _noise_model(self, residual: Array) -> Array:
        parts = self.by_motion(residual)
        of = [lag_products(m.trace.standardised(x), m.counts, self.lags) for m, x in parts]
        return np.asarray(autoregression(np.sum(of, axis=0)[None], self.least_gain)[0])


@dataclass(frozen=True)
class Smooth:
    """The best smooth function of one state."""

    state: str  # its name, see ``_families``, or ``shaking`` or ``jump``
    gain: float  # log-likelihood that it gains over the plain servo, the noise model at its best
    unknowns: int  # number of coefficients, the frequency of a line among them
    jumps_s: tuple[float, ...]  # instant of the most probable jump in each recording
    shares: dict[str, float]  # for each state its gain over the plain servo, less half its unknowns

    def evidence(self, count: float) -> float:
        """Evidence against the plain servo's: Schwarz, Ann. Stat. 6 (1978) 461."""
        return self.gain - 0.5 * self.unknowns * float(np.log(count))


@dataclass(frozen=True)
class Unmodelled:
    """What could be missing, without a name."""

    # energy of the plain fit's residual that is neither noise nor slow wander, in variances of the
    # noise; about 1 where nothing is missing
    excess: float
    smooth: Smooth  # the best smooth function of one state
    # segments outside which the plain servo fits, for each recording, or None
    windows: Windows | None
    # evidence, against the plain servo's, of something of its own in these segments; -inf without
    # them
    windows_evidence: float


def unmodelled(batch: Batch, joints: Sequence[Sequence[Trace]], plain: Fits) -> list[Unmodelled]:
    """Look for physics without a name in the joints of a robot, beside their plain servos."""
    residuals, excesses = beyond_noise(batch, joints, plain)
    servos, separate = [], []
    for j, (kp, kd, latency) in enumerate(plain.servos.theta[:, :3].tolist()):
        suspect = excesses[j] > DECISION.noise_like_excess
        motions = _motions(batch, joints, residuals, j)
        servos.append(ServoMotion(motions, kp, kd, latency, batch.least_gain, batch.lags, suspect))
        fit = plain[np.array([j])]
        separate.append(_intermittent(batch, joints[j], fit, residuals[j]) if suspect else _NOWHERE)
    found = zip(excesses, shared(smooth_function, servos), separate, strict=True)
    return [Unmodelled(left, smooth, *where) for left, smooth, where in found]


def beyond_noise(
    batch: Batch, joints: Sequence[Sequence[Trace]], fits: Fits
) -> tuple[Array, list[float]]:
    """What one fit a joint leaves, shape (J, R, T), and the ``excess`` of each."""
    residuals, noise = residual_angles(batch, fits), np.sqrt(fits.error2 / fits.count)
    return residuals, [
        excess(residuals[j], traces, batch, float(noise[j])) for j, traces in enumerate(joints)
    ]


def excess(
    residual: Sequence[Array], traces: Sequence[Trace], batch: Batch, noise_rad: float
) -> float:
    """Energy of residuals, one a recording, beyond a slow wander, in variances of the noise.

    The residual is whitened for white noise and ``RESIDUAL_WANDER``, or as its ``SlowErrors`` say.
    """
    if traces[0].slow is not None:
        return (noise_rad / traces[0].slow.noise_rad) ** 2
    energy, count = 0.0, 0
    for row, trace in zip(residual, traces, strict=False):
        numerator, denominator, spread = RESIDUAL_WANDER.filter(trace.period_s)
        innovation = lfilter(numerator, denominator, trace.standardised(row[: trace.t.size]))
        used = trace.used.copy()
        used[: batch.lags] = False
        energy += float(np.sum(innovation[used] ** 2)) / (1 + spread)
        count += int(used.sum())
    scale = noise_rad**2 / (1 + spread)
    return energy / count / scale


def _intermittent(
    batch: Batch, traces: Sequence[Trace], plain: Fits, residual: Array, *, rounds: int = 3
) -> tuple[Windows | None, float]:
    """Windows outside which the plain servo of a joint fits, and their evidence."""
    found: Windows = ((),) * len(traces)
    left, gain = residual, 0.0
    for _ in range(rounds):
        rows = measured_only(left, traces)
        within = [inside(t.t, of_trace) for t, of_trace in zip(traces, found, strict=True)]
        sd = robust_sd(np.concatenate(rows), np.concatenate(within))
        found = tuple(windows(t.t, row, sd) for t, row in zip(traces, rows, strict=True))
        seconds = sum(b - a for of_trace in found for a, b in of_trace)
        most = DECISION.segments_share * sum(t.duration_s for t in traces)
        if not any(found) or seconds >= most:
            return _NOWHERE
        kept = []
        for trace, segments in zip(traces, found, strict=True):
            wider = tuple((a - 0.1, b + 0.3) for a, b in segments)
            kept.append(replace(trace, used=trace.used & ~inside(trace.t, wider)))
        outside = Batch([kept])
        white = minimise(outside, plain.servos.of_joints([0]), iterations=8, white=True)
        fit = minimise(outside, white.servos, iterations=8)
        if fit.count[0] <= outside.lags:  # too few samples outside explain nothing
            return _NOWHERE
        square = max(float(fit.error2[0] / fit.count[0]), FINEST_NOISE_RAD**2)
        gain = float(-0.5 * np.log(square) * plain.count[0] - plain.loglikelihood[0])
        left = residual_angles(batch, fit.of_joints(plain.servos.joint.tolist()))[0]
    # Each segment must earn as much as is never left to chance, and so must each second of it.
    costs = [1 + b - a for of_trace in found for a, b in of_trace]
    return found, gain - DECISION.decisive_gain * sum(costs)


def measured_only(residual: Array, traces: Sequence[Trace]) -> list[Array]:
    """Standardised residuals (R, T) of the recordings, NaN where not used, (T,) each."""
    pairs = zip(residual, traces, strict=False)
    return [np.where(t.used, t.standardised(r[: t.t.size]), np.nan) for r, t in pairs]


def _motions(
    batch: Batch, joints: Sequence[Sequence[Trace]], residuals: Array, joint: int
) -> list[JointMotion]:
    """The recordings of a joint, with the simulated angles of its siblings."""
    motions = []
    for r, trace in enumerate(joints[joint]):
        counts = trace.used.copy()
        counts[: batch.lags] = False
        others = [
            other.simulated(residuals[i, k, : other.t.size][other.used])
            for i, sibling in enumerate(joints)
            for k, other in enumerate(sibling)
            if i != joint and other.file == trace.file and other.t.size == trace.t.size
        ]
        siblings_angles = np.array(others).reshape(len(others), trace.t.size)
        own = residuals[joint, r, : trace.t.size]
        angle = trace.simulated(own[trace.used])
        motions.append(JointMotion(trace, angle, own, counts, siblings_angles))
    return motions


def smooth_function(servo: ServoMotion) -> Smooth:
    """Find the state of which a smooth function explains most of the residuals of a servo."""
    plain, model = servo.fit(np.zeros((servo.residual.size, 0)), None)
    families = {state: (columns, columns.shape[1]) for state, columns in _families(servo)}
    jumps: tuple[float, ...] = ()
    if servo.thorough:
        jumps, steps = _jumps(servo, model)
        lines = _shaking(servo, model)
        families |= {"shaking": (lines, lines.shape[1] + 2), "jump": (steps, 3 * len(jumps))}
    levels = {state: servo.fit(columns, model)[0] for state, (columns, _) in families.items()}
    state = max(levels, key=lambda s: levels[s] - 4.0 * families[s][1])
    shares = {s: level - plain - 0.5 * families[s][1] for s, level in levels.items()}
    return Smooth(state, levels[state] - plain, families[state][1], jumps, shares)


def _families(servo: ServoMotion) -> Iterator[tuple[str, Array]]:
    """Names of states, and the angles that smooth functions of each make, shape (N, K)."""
    motions = servo.motions
    position = _splines([m.angle for m in motions])
    speed = [np.gradient(m.angle, m.trace.t) for m in motions]
    signs = [np.tanh(v / 0.02)[:, None] for v in speed]
    yield "position", servo.angles(position)
    yield "speed", servo.angles([np.hstack(x) for x in zip(_splines(speed), signs, strict=True)])
    yield "error", servo.angles(_splines([m.trace.command - m.angle for m in motions]))
    yield "sensor", np.vstack(position)
    drifting = []  # gains and latency that change with time, to the second order
    for motion, torques in zip(motions, servo.gain_torques, strict=True):
        t = motion.trace.t
        passed = ((t - t[0]) / (t[-1] - t[0]))[:, None]
        drifting.append(np.hstack([passed * torques, passed**2 * torques]))
    yield "time", servo.angles(drifting)
    if len({len(m.others) for m in motions}) == 1 and motions[0].others.size:
        accelerations = [
            np.stack([np.gradient(np.gradient(q, m.trace.t), m.trace.t) for q in m.others], axis=1)
            for m in motions
        ]
        yield "other_joint", servo.angles(accelerations)


def _splines(states: Sequence[Array], *, count: int = 8) -> list[Array]:
    """Cubic B-splines over the range of a state, for each recording (T, count)."""
    low, high = np.quantile(np.concatenate(states), [0.0, 1.0])
    inner = np.linspace(low, high + 1e-9, count - 2)
    knots = np.concatenate([[low] * 3, inner, [high + 1e-9] * 3])
    return [
        np.asarray(BSpline.design_matrix(np.clip(x, low, high), knots, 3).toarray()) for x in states
    ]


def _shaking(
    servo: ServoMotion,
    model: Array,
    *,
    shaken_Hz: tuple[float, float] = (0.2, 8.0),
    transform_length: int = 8192,
) -> Array:
    """Angles of torques at the best frequency, a sine and a cosine for each recording."""
    motions = servo.motions
    left, _ = servo.without_gains(model)
    ends = np.cumsum([int(motion.counts.sum()) for motion in motions])[:-1]
    power: Array = np.zeros(transform_length // 2 + 1)
    for part in np.split(left, ends):
        power += np.abs(np.fft.rfft(part, transform_length)) ** 2
    hertz = np.fft.rfftfreq(transform_length, motions[0].trace.period_s)
    power[(hertz < shaken_Hz[0]) | (hertz > shaken_Hz[1])] = 0.0
    blocks = []
    for motion, filtered in zip(motions, servo.filters, strict=True):
        phase = 2 * np.pi * float(hertz[power.argmax()]) * motion.trace.t
        wave = np.stack([np.sin(phase), np.cos(phase)], axis=1)
        blocks.append(lfilter(*filtered, wave, axis=0))
    return block_diag(*blocks)


def _jumps(
    servo: ServoMotion, model: Array, *, spacing_s: float = 0.25
) -> tuple[tuple[float, ...], Array]:
    """The best instant at which the sensor's zero jumps in each recording, and the steps."""
    left, basis = servo.without_gains(model)
    steps, instants = [], []
    for motion in servo.motions:
        t = motion.trace.t
        edge = min(1.0, 0.1 * float(t[-1] - t[0]))
        times = np.arange(t[0] + edge, t[-1] - edge, spacing_s)
        tried = np.zeros((servo.residual.size, times.size))
        for m, part in servo.by_motion(tried):
            if m is motion:
                part[:] = t[:, None] >= times
        seen = servo.whitened(tried, model)
        seen -= basis @ (basis.T @ seen)
        best = int(((seen.T @ left) ** 2 / ((seen**2).sum(axis=0) + 1e-30)).argmax())
        steps.append(tried[:, best])
        instants.append(float(times[best]))
    return tuple(instants), np.column_stack(steps)
