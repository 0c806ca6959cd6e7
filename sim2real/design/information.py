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

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag
from scipy.signal import cont2discrete, lfilter
from scipy.special import ndtri

from sim2real.arrays import Array
from sim2real.design.limits import CommandLimits
from sim2real.identification.priors import MOTOR_SHEET, MotorPrior, motor_prior
from sim2real.identification.problem import ServoProblem, plain_row
from sim2real.inference.normal import Z90
from sim2real.inference.parameters import Parameter, column, kronecker
from sim2real.model import JointModel, Model
from sim2real.recording import PER_INERTIA, Load
from sim2real.robot import Robot
from sim2real.servo.parameters import BASE, COLUMNS, LINE, ROTOR, ROTOR_INERTIA, joint_row
from sim2real.servo.trace import Trace, shows_inertia

GAINS = BASE[:3]
"""Gains and latency, the parameters of every servo."""


@dataclass(frozen=True)
class ServoPrior:
    """Draws of a servo, its parameters that the next recording is to determine, and the noise."""

    names: tuple[str, ...]  # columns of the F parameters (``servo.parameters``)
    rows: Array  # parameters of D servos, which differ in these only, shape (D, P)
    # standard deviations of the logarithm of each parameter in the prior of the fit, infinite where
    # there is none, shape (F,)
    sd: Array
    load: Load  # the load on the shaft
    # standard deviations of errors of the measured angle: independent ones, quantisation included,
    # and those that repeat with the angle, as of an eccentric sensor or cogging
    white_rad: float
    angle_rad: float
    # probability that a set-point does not arrive in its period, late ones by the square
    lost: float

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
    fitted = None if model is None else model.joints.get(limits.joint)
    if load is None and fitted is not None:
        own = PER_INERTIA if fitted.per_inertia else Load(fitted.inertia_kgm2)
        load = fitted.load or own
    load = load or PER_INERTIA
    still = command_trace(load, np.zeros(2), 1.0)
    motor = motor_prior(joint.servo, [still]) if joint.servo.states(*MOTOR_SHEET) else None
    names, row, root = _of_sheet(motor, still) if fitted is None else _of_model(fitted, load)
    points = ndtri(kronecker(draws, len(names), np.random.default_rng(seed)))
    points[0] = 0.0
    rows, columns = np.tile(row, (draws, 1)), [COLUMNS.index(name) for name in names]
    rows[:, columns] *= np.exp(points @ root.T)
    known = {} if motor is None else {p.name: p.prior_sd for p in motor.parameters if p.log}
    sd = np.array([known.get(name, np.inf) for name in names])
    return ServoPrior(names, rows, sd, load, *_noise(model, limits))


def _noise(model: Model | None, limits: CommandLimits) -> tuple[float, float, float]:
    """Errors of the angle that the model states, or else usual ones and the sheet's rounding."""
    white, lost = float(np.hypot(1e-3, limits.resolution_rad / np.sqrt(12))), 0.0025
    joint = None if model is None else model.joints.get(limits.joint)
    if model is None or joint is None:
        return white, white, lost
    figures = model.fit.get(f"{limits.joint}.position_rad", {})
    white = float(figures.get("noise") or white)
    train = float(figures.get("train") or white)
    for effect in (*joint.effects, *model.effects):
        if effect.effect == "packet_loss":
            lost = max(lost, effect.parameters["probability"])
    return white, float(np.sqrt(max(train**2 - white**2, (0.3 * white) ** 2))), lost


Belief = tuple[tuple[str, ...], Array, Array]
"""Names of F parameters, a servo (P,), and a root of the covariance of their logarithms (F, F)."""


def _of_model(joint: JointModel, load: Load) -> Belief:
    """A fitted joint, with its intervals and their correlations."""
    row = joint_row(joint, load)
    known = [n for n in joint.interval if n in COLUMNS and row[COLUMNS.index(n)] > 0]
    names = tuple(dict.fromkeys([*GAINS, *known]))
    values = row[[COLUMNS.index(name) for name in names]]
    ends = np.array([joint.interval.get(name, (0.0, np.inf)) for name in names])
    half = (ends[:, 1] - ends[:, 0]) / (2 * Z90 * np.maximum(values, 1e-12))
    sd = np.where(np.isfinite(half), np.minimum(half, 0.5), 0.5)
    correlation = np.eye(len(names))
    for pair, value in joint.correlation.items():
        places = [names.index(name) for name in pair.split(", ") if name in names]
        if len(places) == 2:
            correlation[places, places[::-1]] = value
    level, directions = np.linalg.eigh(correlation)
    return names, row, sd[:, None] * directions * np.sqrt(np.maximum(level, 0.0))


def _of_sheet(motor: MotorPrior | None, still: Trace) -> Belief:
    """A servo as the data sheet says, of usual frequency, damping ratio and latency."""
    # medians in rad/s, 1 and s, and standard deviations of the logarithms
    (frequency, damping, latency), sd = (24.0, 0.72, 0.028), np.array([0.4, 0.34, 0.6])
    line: tuple[str, ...] = ()
    row = plain_row(0.0, 0.0, latency)
    row[3:5] = still.load.inertia_kgm2, still.load.gravity_Nm
    # kp is the frequency squared, kd twice the ratio times the frequency, times the inertia
    root = np.array([[2.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]]) * sd
    if motor is not None:
        line = (*LINE, ROTOR) if shows_inertia([still]) else LINE
        parameters = [motor[name] for name in line]
        middle, sd = column(parameters, "nominal"), column(parameters, "prior_sd")
        # lighter rotors than usual: stated loads mostly include the rotor
        middle[2:] -= sd[2:]
        row[[COLUMNS.index(name) for name in line]] = np.exp(middle)
        root = block_diag(root, np.diag(sd))
    row[:2] = np.array([frequency**2, 2 * damping * frequency]) * (row[3] + row[ROTOR_INERTIA])
    return (*GAINS, *line), row, root


def command_trace(load: Load, command: Array, period_s: float) -> Trace:
    """A command (T,) as if recorded, all angles 0."""
    t = period_s * np.arange(command.size, dtype=np.float64)
    return Trace("next", "next", t, command, np.zeros(t.size), load, np.ones(t.size, dtype=bool))


def rms_torque(load: Load, angle: Array, period_s: float) -> Array:
    """Root mean square of the torque that moves a load along angles (..., T), N m, shape (...)."""
    acceleration = np.zeros_like(angle)
    acceleration[..., 1:-1] = np.diff(angle, 2, axis=-1) / period_s**2
    torque = load.inertia_kgm2 * acceleration + load.gravity_Nm * np.sin(angle)
    return np.asarray(np.sqrt(np.mean(torque**2, axis=-1)))


@dataclass(frozen=True)
class Information:
    """Scores commands by how precisely a fit to their recording would determine a servo."""

    prior: ServoPrior  # prior of the servo
    limits: CommandLimits  # limits of the commands

    def __call__(self, commands: Array) -> Array:
        """Score of each command (N, T), shape (N,).

        Minus logarithms of the widest interval of gains and latency and, with a weight of 0.3, of
        all, averaged over the prior, less a penalty beyond the torque budget.
        """
        half_width, torque = self.precision(commands)
        log_width = np.log(half_width)
        worst = log_width[:, :, : len(GAINS)].max(axis=2)
        score = -(worst + 0.3 * log_width.mean(axis=2)).mean(axis=1)
        known = self.prior.load is not PER_INERTIA
        excess = torque / (self.limits.rms_torque_Nm if known else np.inf) - 1
        return np.asarray(score - 10 * np.maximum(excess, 0.0).mean(axis=1))

    def precision(self, commands: Array) -> tuple[Array, Array]:
        """What is expected of a recording of each command (N, T).

        Half-widths of 90 % intervals, relative to the parameters of each servo, shape (N, D, F),
        and the root mean square of the torque that the motion takes, N m, shape (N, D).
        """
        stated, period = self.prior, self.limits.period_s
        angle, slopes = self.sensitivities(commands)
        transposed = np.swapaxes(slopes, 2, 3)
        # the same waves for all commands that are compared
        rng = np.random.default_rng(0)
        number = rng.standard_normal(16) / 0.1  # rad over which these errors change
        phase = rng.uniform(0, 2 * np.pi, number.size)
        some = np.s_[:, :, ::2]  # errors by the angle change slowly
        wave = np.cos(angle[some][..., None] * number + phase)
        by_angle = 2 * np.swapaxes(slopes[some], 2, 3) @ wave
        change2 = np.diff(commands, axis=1, prepend=commands[:, :1])[:, None, :, None] ** 2
        by_loss = self._by_command(slopes)
        white2 = stated.white_rad**2
        prior = np.diag(1 / self.prior.sd**2 + 1e-3)  # so that it has an inverse
        gram = transposed @ slopes / white2
        repeated = stated.angle_rad**2 * 2 / number.size * by_angle @ np.swapaxes(by_angle, 2, 3)
        lost = stated.lost * np.swapaxes(by_loss, 2, 3) @ (change2 * by_loss)
        inverse = np.linalg.inv(gram + prior)
        covariance = inverse @ (gram + (repeated + lost) / white2**2 + prior) @ inverse
        variance = np.diagonal(covariance, axis1=2, axis2=3)
        half_width = np.asarray(Z90 * np.sqrt(np.maximum(variance, 1e-18)))
        return half_width, rms_torque(self.prior.load, angle, period)

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
