"""Expected precision of a servo's parameters after a recording of given commands.

Fisher information of the simulated angles in the noise of the fit, averaged over the prior of the
servo. The intervals are those of a least-squares fit whose residual is correlated: with J
the derivatives by the logarithms of the parameters, S the covariance of the errors, s2 the variance
of white noise and P the precision of the prior::

    H = J' J / s2 + P        C = inv(H) (J' S J / s2^2 + P) inv(H)

Source: White, Econometrica 50 (1982) 1-25. Errors that repeat with the angle are a random function
of it with a Gaussian spectrum, by random Fourier features (Rahimi and Recht, NeurIPS 2007). A
set-point that is lost is an error of the command by its last change.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.signal import cont2discrete, lfilter

from sim2real.arrays import Array
from sim2real.design.limits import CommandLimits
from sim2real.identification.priors import MOTOR_SHEET, motor_prior
from sim2real.identification.problem import ServoProblem, plain_row
from sim2real.inference.normal import Z90
from sim2real.inference.parameters import Parameter, column, kronecker
from sim2real.model import JointModel, Model
from sim2real.recording import PER_INERTIA, Load
from sim2real.robot import Robot, Servo
from sim2real.servo.parameters import BASE, COLUMNS, LINE, ROTOR, ROTOR_INERTIA, joint_row
from sim2real.servo.trace import Trace, shows_inertia

GAINS = BASE[:3]
"""Gains and latency, the parameters of every servo."""


@dataclass(frozen=True)
class AngleError:
    """Errors of the measured angle about the model; late set-points count as lost by the square."""

    white_rad: float  # standard deviation of independent errors, quantisation included
    angle_rad: float  # of errors that repeat with the angle: an eccentric sensor, cogging
    angle_scale_rad: float = 0.1  # angle over which these change
    lost: float = 0.0025  # probability that a set-point does not arrive in its period


@dataclass(frozen=True)
class ServoPrior:
    """Draws of a servo, its parameters that the next recording is to determine, and the noise."""

    names: tuple[str, ...]  # columns of the F parameters (``servo.parameters``)
    rows: Array  # parameters of D servos, which differ in these only, shape (D, P)
    # standard deviations of the logarithm of each parameter in the prior of the fit, infinite where
    # there is none, shape (F,)
    sd: Array
    load: Load  # the load on the shaft
    noise: AngleError  # errors of the measured angle

    @property
    def values(self) -> Array:
        """The F parameters of each servo, shape (D, F)."""
        return self.rows[:, [COLUMNS.index(name) for name in self.names]]


def prior_of(
    robot: Robot,
    model: Model | None,
    limits: CommandLimits,
    *,
    load: Load | None = None,
    draws: int = 8,
    seed: int = 0,
) -> ServoPrior:
    """The prior of one joint, by D ``draws`` of servos from its model, or else its data sheet."""
    joint = robot.joint(limits.joint)
    assert joint is not None
    rng = np.random.default_rng(seed)
    fitted = None if model is None else model.joints.get(limits.joint)
    # usual noise of a sensor and the quantisation that the data sheet states
    white = float(np.hypot(1e-3, limits.resolution_rad / np.sqrt(12)))
    if model is None or fitted is None:
        load = load or PER_INERTIA
        names, rows = _from_sheet(joint.servo, load, draws, rng)
        noise = AngleError(white, white)
    else:
        names, rows = _from_model(fitted, load, draws, rng)
        own = PER_INERTIA if fitted.per_inertia else Load(fitted.inertia_kgm2)
        load = load or fitted.load or own
        figures = model.fit.get(f"{limits.joint}.position_rad", {})
        white = float(figures.get("noise") or white)
        train = float(figures.get("train") or white)
        noise = AngleError(white, float(np.sqrt(max(train**2 - white**2, (0.3 * white) ** 2))))
        for effect in (*fitted.effects, *model.effects):
            if effect.effect == "packet_loss":
                noise = replace(noise, lost=max(noise.lost, effect.parameters["probability"]))
    return ServoPrior(names, rows, _prior_sd(names, joint.servo, load), load, noise)


def _from_model(
    joint: JointModel,
    load: Load | None,
    draws: int,
    rng: np.random.Generator,
    *,
    widest_sd: float = 0.5,
) -> tuple[tuple[str, ...], Array]:
    """Draws from the intervals of a fitted joint and their correlations, as logarithms."""
    row = joint_row(joint, load)
    known = [n for n in joint.interval if n in COLUMNS and row[COLUMNS.index(n)] > 0]
    names = tuple(dict.fromkeys([*GAINS, *known]))
    columns = [COLUMNS.index(name) for name in names]
    ends = np.array([joint.interval.get(name, (0.0, np.inf)) for name in names])
    half = (ends[:, 1] - ends[:, 0]) / (2 * Z90 * np.maximum(row[columns], 1e-12))
    sd = np.where(np.isfinite(half), np.minimum(half, widest_sd), widest_sd)
    correlation = np.eye(len(names))
    for pair, value in joint.correlation.items():
        places = [names.index(name) for name in pair.split(", ") if name in names]
        if len(places) == 2:
            correlation[places, places[::-1]] = value
    level, directions = np.linalg.eigh(correlation)
    root = directions * np.sqrt(np.maximum(level, 0.0))
    offset = sd * (rng.standard_normal((draws, len(names))) @ root.T)
    offset[0] = 0.0
    rows = np.tile(row, (draws, 1))
    rows[:, columns] = row[columns] * np.exp(offset)
    return names, rows


def _from_sheet(
    servo: Servo,
    load: Load,
    draws: int,
    rng: np.random.Generator,
    *,
    frequency_rad_s: tuple[float, float] = (12.0, 50.0),
    damping_ratio: tuple[float, float] = (0.4, 1.3),
    latency_s: tuple[float, float] = (0.01, 0.08),
) -> tuple[tuple[str, ...], Array]:
    """Servos that the data sheet allows, of usual frequencies, damping ratios and latencies."""
    points = kronecker(draws, 6, rng)
    low, high = np.log([frequency_rad_s, damping_ratio, latency_s]).T
    frequency, damping, latency = np.exp(low + points[:, :3] * (high - low)).T
    line: tuple[str, ...] = ()
    rows = np.tile(plain_row(0.0, 0.0, 0.0), (draws, 1))
    if servo.states(*MOTOR_SHEET):
        still = command_trace(load, np.zeros(2), 1.0)
        line = (*LINE, ROTOR) if shows_inertia([still]) else LINE
        prior = motor_prior(servo, [still])
        parameters = [prior[name] for name in line]
        # of the prior's rotors the lighter ones: stated loads mostly include the rotor
        middle = np.array([0.5, 0.5, 1.0])[: len(line)]
        share = np.sqrt(12) * (points[:, 3 : 3 + len(line)] - middle)
        motor = np.exp(column(parameters, "nominal") + share * column(parameters, "prior_sd"))
        rows[:, [COLUMNS.index(name) for name in line]] = motor
    inertia = load.inertia_kgm2 + rows[:, ROTOR_INERTIA]
    rows[:, 0] = frequency**2 * inertia
    rows[:, 1] = 2 * damping * frequency * inertia
    rows[:, 2] = latency
    rows[:, 3:5] = load.inertia_kgm2, load.gravity_Nm
    return (*GAINS, *line), rows


def _prior_sd(names: tuple[str, ...], servo: Servo, load: Load) -> Array:
    """Standard deviations of the logarithms in the prior of the fit, shape (F,)."""
    known: dict[str, float] = {}
    if servo.states(*MOTOR_SHEET):
        prior = motor_prior(servo, [command_trace(load, np.zeros(2), 1.0)])
        known = {p.name: p.prior_sd for p in prior.parameters if p.log}
    return np.array([known.get(name, np.inf) for name in names])


def command_trace(load: Load, command: Array, period_s: float) -> Trace:
    """A command (T,) as if recorded, all angles 0."""
    t = period_s * np.arange(command.size, dtype=np.float64)
    return Trace("next", "next", t, command, np.zeros(t.size), load, np.ones(t.size, dtype=bool))


@dataclass(frozen=True)
class Precision:
    """Expected precision of F parameters after each of N commands, for D servos."""

    covariance: Array  # covariance of the logarithms of the parameters, shape (N, D, F, F)
    rms_torque_Nm: Array  # root mean square of the torque that the motion takes, shape (N, D)

    @property
    def half_width(self) -> Array:
        """Half-widths of 90 % intervals, relative to the parameters, shape (N, D, F)."""
        variance = np.diagonal(self.covariance, axis1=2, axis2=3)
        return np.asarray(Z90 * np.sqrt(np.maximum(variance, 0.0)))


@dataclass(frozen=True)
class Information:
    """Scores commands by how precisely a fit to their recording would determine a servo."""

    prior: ServoPrior  # prior of the servo
    limits: CommandLimits  # limits of the commands
    features: int = 16  # number of Fourier features of the errors that repeat with the angle
    every: int = 2  # number of samples per sample at which these errors are evaluated
    # weight of the mean logarithm of all widths; that of the widest of the gains is 1
    others: float = 0.3

    @cached_property
    def _waves(self) -> tuple[Array, Array]:
        """Wave numbers and phases, the same for all commands that are compared."""
        rng = np.random.default_rng(0)
        number = rng.standard_normal(self.features) / self.prior.noise.angle_scale_rad
        return number, rng.uniform(0, 2 * np.pi, self.features)

    def __call__(self, commands: Array) -> Array:
        """Score of each command (N, T), shape (N,), see ``scores``."""
        return self.scores(self.statistics(commands, 1)[:, 0])

    def scores(self, statistics: Array) -> Array:
        """Scores of commands with these statistics (N, K), shape (N,).

        Minus logarithms of the widest interval of gains and latency and of all, averaged over the
        prior, less a penalty beyond the torque budget.
        """
        precision = self.precision_of(statistics)
        log_width = np.log(np.maximum(precision.half_width, 1e-9))
        worst = log_width[:, :, : len(GAINS)].max(axis=2)
        score = -(worst + self.others * log_width.mean(axis=2)).mean(axis=1)
        known = self.prior.load is not PER_INERTIA
        excess = precision.rms_torque_Nm / (self.limits.rms_torque_Nm if known else np.inf) - 1
        return np.asarray(score - 10 * np.maximum(excess, 0.0).mean(axis=1))

    def precision(self, commands: Array) -> Precision:
        """Expected precision after each command (N, T)."""
        return self.precision_of(self.statistics(commands, 1)[:, 0])

    def statistics(self, commands: Array, parts: int) -> Array:
        """Statistics (N, parts, K) of equal parts of commands (N, T); those of all are the sum."""
        angle, slopes = self.sensitivities(commands)
        load, (number, phase) = self.prior.load, self._waves
        torque2 = load_torque(load, angle, self.limits.period_s) ** 2
        by_command = self._by_command(slopes)
        change2 = np.diff(commands, axis=1, prepend=commands[:, :1])[:, None, :, None] ** 2
        found = []
        for part in np.array_split(np.arange(commands.shape[1]), parts):
            slope, response = slopes[:, :, part], by_command[:, :, part]
            some = np.s_[:, :, :: self.every]  # errors by the angle change slowly
            wave = np.cos(angle[:, :, part][some][..., None] * number + phase)
            sums = (
                np.swapaxes(slope, 2, 3) @ slope,
                np.swapaxes(response, 2, 3) @ (change2[:, :, part] * response),
                self.every * np.swapaxes(slope[some], 2, 3) @ wave,
                torque2[:, :, part].sum(axis=2)[..., None] / commands.shape[1],
            )
            found.append(np.concatenate([x.reshape(*x.shape[:2], -1) for x in sums], axis=2))
        return np.stack(found, axis=1).reshape(len(commands), parts, -1)

    def precision_of(self, statistics: Array) -> Precision:
        """Expected precision after commands with these statistics (N, K)."""
        noise, D, F = self.prior.noise, *self.prior.values.shape
        each = statistics.reshape(len(statistics), D, -1)
        gram = each[:, :, : F * F].reshape(-1, D, F, F)
        by_loss = each[:, :, F * F : 2 * F * F].reshape(-1, D, F, F)
        by_angle = each[:, :, 2 * F * F : -1].reshape(-1, D, F, self.features)
        white = noise.white_rad
        prior = np.diag(1 / self.prior.sd**2 + 1e-3)  # so that it has an inverse
        repeated = noise.angle_rad**2 * 2 / self.features * by_angle @ np.swapaxes(by_angle, 2, 3)
        inverse = np.linalg.inv(gram / white**2 + prior)
        middle = gram / white**2 + (repeated + noise.lost * by_loss) / white**4 + prior
        return Precision(inverse @ middle @ inverse, np.sqrt(each[:, :, -1]))

    def sensitivities(self, commands: Array) -> tuple[Array, Array]:
        """Angles in rad, shape (N, D, T), and derivatives by logarithms, shape (N, D, T, F)."""
        prior, period = self.prior, self.limits.period_s
        traces = [command_trace(prior.load, command, period) for command in commands]
        free = tuple(Parameter(name, 1e-12, 1e12, 1.0, log=True) for name in prior.names)
        problem = ServoProblem(traces, prior.rows[0], free)
        angle, slopes = problem.slopes(np.log(np.maximum(prior.values, 1e-12)))
        shape = len(prior.rows), *commands.shape
        return (
            np.moveaxis(angle.reshape(shape), 1, 0),
            np.moveaxis(slopes.reshape(*shape, -1), 1, 0),
        )

    def _by_command(self, slopes: Array) -> Array:
        """Sum over time of slopes (N, D, T, F) times the response to one set-point, same shape."""
        out = np.empty_like(slopes)
        for d, row in enumerate(self.prior.rows):
            inertia = row[3] + row[ROTOR_INERTIA]
            servo = ([row[0]], [inertia, row[1], row[0] + row[4]])
            numerator, denominator, _ = cont2discrete(servo, self.limits.period_s)
            backwards = slopes[:, d, ::-1]
            out[:, d] = lfilter(numerator.ravel(), denominator, backwards, axis=1)[:, ::-1]
        return out


def load_torque(load: Load, angle: Array, period_s: float) -> Array:
    """Torque that moves a load along angles (..., T), N m, same shape."""
    acceleration = np.zeros_like(angle)
    acceleration[..., 1:-1] = np.diff(angle, 2, axis=-1) / period_s**2
    return np.asarray(load.inertia_kgm2 * acceleration + load.gravity_Nm * np.sin(angle))
