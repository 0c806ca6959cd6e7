"""The likelihood of a servo: innovations of noise that is correlated in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sim2real.inference.correlated_noise import counting
from sim2real.inference.parameters import Priors
from sim2real.model import JointModel
from sim2real.recording import PER_INERTIA, Load
from sim2real.servo.batch import Batch
from sim2real.servo.innovations import WhitenedServo
from sim2real.servo.parameters import COLUMNS, FIRST_COLUMN, joint_row
from sim2real.servo.rollout import STEPS_PER_RADIAN
from sim2real.servo.trace import Trace

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

THREADS = 2
LONGEST_SUBSTEP_S = 0.001
"""With it sub-steps move a sharp posterior by less than a tenth of its width (tested)."""

RANDOM_EFFECTS = ("latency_jitter", "packet_loss")
"""Effects whose draws cannot be known from their parameters; they are held, not sampled."""


@dataclass(frozen=True)
class ServoData:
    """One joint as a posterior needs it.

    Attributes:
        traces: Its recordings.
        row: Parameters that are not sampled stay as here, shape (P,); loads are the recordings'.
        priors: Priors of those that are, F of them.
    """

    traces: Sequence[Trace]
    row: Array
    priors: Priors

    @cached_property
    def batch(self) -> Batch:
        """The recordings, ready for rollouts.

        The noise may wander without bound, as what no model explains must be able to.
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
        """Samples that are used, as are the ``lags`` before them, one array (T,) a recording."""
        return [counting(trace.used, lags) for trace in self.traces]


def servo_data(traces: Sequence[Trace], joint: JointModel, priors: Priors) -> ServoData:
    """The joint's recordings, its parameters, and which of them are sampled.

    Effects of chance (``RANDOM_EFFECTS``) are left out: their mean is what a rollout without them
    shows, and what they add is noise.
    """
    row = joint_row(joint, traces[0].load)
    for name in RANDOM_EFFECTS:
        row[FIRST_COLUMN[name]] = 0.0
    return ServoData(traces, row, priors)


def loaded(trace: Trace, joint: JointModel) -> Trace:
    """The trace with a load in the units of the model, be it per unit of inertia or not."""
    if joint.per_inertia:
        return replace(trace, load=PER_INERTIA)
    if trace.load is PER_INERTIA:
        return replace(trace, load=joint.load or Load(joint.inertia_kgm2))
    return trace


@dataclass(frozen=True)
class Likelihood:
    """Log-likelihood of many values at once, in one launch.

    Simulated minus measured angles are whitened by an autoregression that is held; the size of the
    innovations is integrated out under Jeffreys' prior, which leaves -(n - p)/2 log(sum of squares)
    (Box and Tiao, Bayesian Inference in Statistical Analysis (1973), sec. 2.7), n innovations and p
    coefficients.

    Attributes:
        data: The joint.
        autoregression: Coefficients of the noise, shape (p,).
    """

    data: ServoData
    autoregression: Array

    @cached_property
    def servo(self) -> WhitenedServo:
        """The recordings, ready for servos of any parameters.

        Exact where the servo is linear, else with one sub-step, fine enough for the model's gains.
        """
        found = WhitenedServo(
            self.data.traces,
            self.data.counts(self.autoregression.size),
            self.autoregression,
            threads=THREADS,
        )
        if not found.is_linear(self.data.theta(np.ones((1, len(self.data.columns))))):
            row = self.data.row[None]
            found.substep_s = found.substep(row, STEPS_PER_RADIAN, LONGEST_SUBSTEP_S)
        return found

    @property
    def exact(self) -> bool:
        """Whether the servo is solved exactly between events."""
        return bool(np.isinf(self.servo.substep_s))

    @cached_property
    def freedom(self) -> int:
        """Innovations that count, less the coefficients."""
        lags = self.autoregression.size
        return max(int(sum(c.sum() for c in self.data.counts(lags))) - lags, 1)

    def __call__(self, values: Array) -> Array:
        """Log-likelihood of ``values`` (B, F) up to a constant, shape (B,); never NaN."""
        with np.errstate(divide="ignore", invalid="ignore"):
            found = -0.5 * self.freedom * np.log(self.servo.energy(self.data.theta(values)))
        return np.where(np.isfinite(found), found, -np.inf)
