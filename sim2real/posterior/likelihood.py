"""The likelihood of a servo: innovations of noise that is correlated in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sim2real.arrays import Array, Mask
from sim2real.inference.correlated_noise import counting
from sim2real.inference.parameters import Priors
from sim2real.model import JointModel
from sim2real.recording import PER_INERTIA, Load
from sim2real.servo.batch import Batch
from sim2real.servo.parameters import COLUMNS, FIRST_COLUMN, joint_row
from sim2real.servo.rollout import STEPS_PER_RADIAN, WhitenedServo
from sim2real.servo.trace import Trace

THREADS = 2
LONGEST_SUBSTEP_S = 0.001
"""With it, the integration error shifts a sharp posterior by less than 0.1 widths (tested)."""

RANDOM_EFFECTS = ("latency_jitter", "packet_loss")
"""Effects that are random for given parameters; their parameters are not sampled."""


@dataclass(frozen=True)
class ServoData:
    """Recordings, parameters and priors of one joint.

    Attributes:
        traces: Its recordings.
        row: Values of the parameters that are not sampled, shape (P,); loads are from the traces.
        priors: Priors of the F sampled parameters.
    """

    traces: Sequence[Trace]
    row: Array
    priors: Priors

    @cached_property
    def batch(self) -> Batch:
        """The recordings, ready for rollouts.

        The slow drift of the noise is not bounded, to include errors that no model explains.
        """
        return Batch([self.traces], threads=THREADS, bounded=False)

    @property
    def columns(self) -> list[int]:
        """Columns of the sampled parameters."""
        return [COLUMNS.index(name) for name in self.priors.names]

    def theta(self, values: Array) -> Array:
        """Parameter rows (B, P) for ``values`` (B, F) of the sampled ones."""
        rows = np.tile(self.row, (values.shape[0], 1))
        rows[:, self.columns] = values
        return rows

    def counts(self, lags: int) -> list[Mask]:
        """Masks of the samples that are used with all ``lags`` before them, (T,) per recording."""
        return [counting(trace.used, lags) for trace in self.traces]


def servo_data(traces: Sequence[Trace], joint: JointModel, priors: Priors) -> ServoData:
    """The joint's recordings, its parameters, and which of them are sampled.

    ``RANDOM_EFFECTS`` are set to 0: a rollout without them has approximately their mean response,
    and the deviation from it is noise.
    """
    row = joint_row(joint, traces[0].load)
    for name in RANDOM_EFFECTS:
        row[FIRST_COLUMN[name]] = 0.0
    return ServoData(traces, row, priors)


def loaded(trace: Trace, joint: JointModel) -> Trace:
    """The trace with its load, or ``PER_INERTIA`` if the model is per unit of inertia."""
    if joint.per_inertia:
        return replace(trace, load=PER_INERTIA)
    if trace.load is PER_INERTIA:
        return replace(trace, load=joint.load or Load(joint.inertia_kgm2))
    return trace


@dataclass(frozen=True)
class Likelihood:
    """Log-likelihood of many parameter vectors in one launch.

    Simulated minus measured angles are whitened by a fixed autoregression; the variance of the n
    innovations is integrated out under Jeffreys' prior, so that the log-likelihood is -(n - p)/2
    log(sum of squares) with p coefficients (Box and Tiao, Bayesian Inference in Statistical
    Analysis (1973), sec. 2.7).

    Attributes:
        data: The joint.
        autoregression: Coefficients of the noise, shape (p,).
    """

    data: ServoData
    autoregression: Array

    @cached_property
    def servo(self) -> WhitenedServo:
        """Simulator of the recordings.

        Exact if the servo is linear, else with one sub-step that resolves the model's gains.
        """
        servo = WhitenedServo(
            self.data.traces,
            self.data.counts(self.autoregression.size),
            self.autoregression,
            threads=THREADS,
        )
        if not servo.is_linear(self.data.theta(np.ones((1, len(self.data.columns))))):
            row = self.data.row[None]
            servo.substep_s = float(servo.substeps(row, STEPS_PER_RADIAN, LONGEST_SUBSTEP_S).min())
        return servo

    @property
    def exact(self) -> bool:
        """Whether the servo is solved exactly between events."""
        return bool(np.isinf(self.servo.substep_s))

    @cached_property
    def freedom(self) -> int:
        """Number of innovations that count, minus the number of coefficients."""
        lags = self.autoregression.size
        return max(int(sum(c.sum() for c in self.data.counts(lags))) - lags, 1)

    def __call__(self, values: Array) -> Array:
        """Log-likelihood of ``values`` (B, F) up to a constant, shape (B,); never NaN."""
        with np.errstate(divide="ignore", invalid="ignore"):
            value = -0.5 * self.freedom * np.log(self.servo.energy(self.data.theta(values)))
        return np.where(np.isfinite(value), value, -np.inf)

    def log_posterior(self, z: Array) -> Array:
        """Log-posterior of unbounded coordinates (B, F), up to a constant, shape (B,)."""
        priors = self.data.priors
        value = self(priors.values(z)) + priors.log_density(z)
        return np.where(np.isfinite(value), value, -np.inf)
