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

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.signal import cont2discrete, lfilter

from sim2real.arrays import Array
from sim2real.design.limits import CommandLimits
from sim2real.design.prior import GAINS, ServoPrior
from sim2real.inference.normal import Z90
from sim2real.recording import PER_INERTIA
from sim2real.servo.parameters import ROTOR_INERTIA
from sim2real.servo.rollout import Simulator
from sim2real.servo.trace import Trace


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
    substep_s: float = 0.004  # longest sub-step of the rollouts, s
    difference: float = 1e-3  # step of the forward differences, relative to a parameter
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

        Minus the logarithm of the widest interval of gains and latency, plus a share of that of all
        parameters, averaged over the servos of the prior. What exceeds the torque budget is
        penalised.
        """
        precision = self.precision_of(statistics)
        log_width = np.log(np.maximum(precision.half_width, 1e-9))
        gains = [k for k, name in enumerate(self.prior.names) if name in GAINS]
        worst = log_width[:, :, gains].max(axis=2)
        score = -(worst + self.others * log_width.mean(axis=2)).mean(axis=1)
        known = self.prior.load is not PER_INERTIA
        excess = precision.rms_torque_Nm / (self.limits.rms_torque_Nm if known else np.inf) - 1
        return np.asarray(score - 10 * np.maximum(excess, 0.0).mean(axis=1))

    def precision(self, commands: Array) -> Precision:
        """Expected precision after each command (N, T)."""
        return self.precision_of(self.statistics(commands, 1)[:, 0])

    def statistics(self, commands: Array, parts: int) -> Array:
        """What the scores depend on, for equal parts of commands (N, T), shape (N, parts, K).

        Those of a command are the sum of those of its parts. A servo forgets in a fraction of a
        second, so that the parts of different commands, joined, have about the sum of theirs.
        """
        angle, slopes = self.sensitivities(commands)
        load, period, (number, phase) = self.prior.load, self.limits.period_s, self._waves
        acceleration = np.diff(angle, 2, axis=2, append=0.0, prepend=0.0) / period**2
        acceleration[:, :, [0, -1]] = 0.0
        torque2 = (load.inertia_kgm2 * acceleration + load.gravity_Nm * np.sin(angle)) ** 2
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
        noise, D, F = self.prior.noise, len(self.prior.rows), len(self.prior.names)
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
        prior = self.prior
        t = self.limits.times(commands.shape[1] * self.limits.period_s)
        still, used = np.zeros(t.size), np.ones(t.size, dtype=bool)
        traces = [Trace("next", "next", t, c, still, prior.load, used) for c in commands]
        D, F = len(prior.rows), len(prior.names)
        rows = np.repeat(prior.rows[:, None], 1 + F, axis=1)
        for k, column in enumerate(prior.columns):
            rows[:, 1 + k, column] *= 1 + self.difference
        simulator = Simulator(traces, threads=2)
        flat = rows.reshape(D * (1 + F), -1)
        substep = np.inf if simulator.is_linear(flat) else self.substep_s
        angles = np.array(simulator.angles(flat, substep)).reshape(len(commands), D, 1 + F, t.size)
        slopes = (angles[:, :, 1:] - angles[:, :, :1]) / self.difference
        return angles[:, :, 0], np.moveaxis(slopes, 2, 3)

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
