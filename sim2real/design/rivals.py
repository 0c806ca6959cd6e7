"""Commands that tell rival sets of effects apart: the entropy over sets that a recording leaves.

Each set predicts y ~ N(m_i, I + U_i U_i'), whitened by the noise, with what its parameters, fitted
to the recordings so far, may still be (Box and Hill, Technometrics 9 (1967) 57-71). Two sets are as
far apart as the Bhattacharyya distance

    d_ij = r' S^-1 r / 8 + log(|S| / sqrt(|S_i| |S_j|)) / 2,   S = (S_i + S_j) / 2,  r = m_i - m_j;

with probabilities p the entropy that remains is at most sum_i p_i log(sum_j p_j exp(-d_ij) / p_i)
(Kolchinsky and Tracey, Entropy 19 (2017) 361, eq. 10). As the noise is fitted, the evidence of n
samples is at most n/2 log(1 + r'r / n) (Brockwell and Davis, Time Series, 1991, section 5.8), and a
diagnosis trusts a share of it (``effect_probabilities.trusted_share``).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sim2real.arrays import Array
from sim2real.design.information import command_trace, rms_torque
from sim2real.design.limits import AS_IT_IS, Context
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.rival_sets import JointRivals, OpenSets, entropy
from sim2real.diagnose.screening import NUISANCES
from sim2real.inference.correlated_noise import whitened
from sim2real.recording import PER_INERTIA
from sim2real.servo.parameters import COLUMNS, FIRST_EFFECT_COLUMN
from sim2real.servo.rollout import Simulator, coarse_substep

_OWNERS = np.array([name.partition(".")[0] for name in COLUMNS])
"""Effect of each column of a row."""
_DIFFERENCE = 0.05
"""Step of differences, in standard deviations."""


class RivalObjective(ABC):
    """Scores commands by the entropy that they leave over M sets of effects."""

    def __init__(self, rivals: OpenSets, *, uniform: float = 0.0) -> None:
        """Give all sets the same ``uniform`` share of the probability."""
        self.rivals = rivals
        p = np.array([one.probability for one in rivals.sets])
        self.probability = (1 - uniform) * p / p.sum() + uniform / p.size

    @abstractmethod
    def excess(self, commands: Array) -> Array:
        """How much commands exceed limits of torque or place, relative or in m, (N,); 0 if kept."""

    @abstractmethod
    def predictions(self, commands: Array) -> Iterator[tuple[Array, Array, float]]:
        """For each command whitened predictions (M, n), spreads (M, F, n), and trusted share."""

    def __call__(self, commands: Array, *, penalty: float = 10.0) -> Array:
        """Scores of set-points in rad, (N, T) or (N, T, J), shape (N,); -inf where it diverges.

        Minus the entropy that remains, in nats, or that before the recording and a ``penalty`` per
        unit of what exceeds limits.
        """
        excess = self.excess(commands)
        scores = np.asarray(-entropy(self.probability) - penalty * excess)
        kept = excess == 0.0
        if kept.any():
            scores[kept] = -remaining_entropy(self.probability, self.distances(commands[kept]))
        return scores

    def distances(self, commands: Array) -> Array:
        """Bhattacharyya distances of all pairs of sets, shape (N, M, M); NaN where it diverges."""
        return np.array([x[2] * distances(*x[:2]) for x in self.predictions(commands)])


class JointObjective(RivalObjective):
    """What commands tell of the sets of effects that are open on one joint, in a context."""

    rivals: JointRivals

    def __init__(
        self, rivals: JointRivals, context: Context = AS_IT_IS, *, rms_torque_Nm: float = np.inf
    ) -> None:
        super().__init__(rivals)
        self.context, sets = context, rivals.sets
        self._rms = np.inf if context.load(rivals) is PER_INERTIA else rms_torque_Nm
        spreads = np.zeros((len(sets), max(one.columns.size for one in sets) + 1, len(COLUMNS)))
        for spread, one in zip(spreads, sets, strict=True):
            # every servo has a little of these waves of the angle
            alike = {effect.name for effect in NUISANCES} - set(one.effects)
            kept = ~np.isin(_OWNERS[one.columns], list(alike))
            root = _DIFFERENCE * root_of_inverse(one.information)[kept]
            spread[1 : 1 + root.shape[1], one.columns[kept]] = root.T
        theta = np.array([one.theta for one in sets])
        without = [np.where(np.isin(_OWNERS, one.effects), 0.0, one.theta) for one in sets]
        plain = sets[0].columns[sets[0].columns < FIRST_EFFECT_COLUMN]
        self._plain = plain.size
        moved = theta[0] * (1 + _DIFFERENCE * np.eye(len(COLUMNS))[plain])
        self._rows = np.vstack([*(theta[:, None] + spreads), without, moved])
        self._gain = np.array([one.gain for one in sets])

    def excess(self, commands: Array) -> Array:
        """Torque of the most probable set beyond the largest, relative to it, shape (N,)."""
        if not np.isfinite(self._rms):
            return np.zeros(len(commands))
        angles = np.concatenate(self._angles(commands, self._rows[:1]))
        torque = rms_torque(self.context.load(self.rivals), angles, self.rivals.period_s)
        return np.nan_to_num(np.maximum(torque / self._rms - 1, 0.0), nan=np.inf)

    def predictions(self, commands: Array) -> Iterator[tuple[Array, Array, float]]:
        """For each command whitened predictions (M, n), spreads (M, F, n), and trusted share."""
        M, noise = self.probability.size, self.rivals.autoregression
        for angles in self._angles(commands, self._rows):
            signals = whitened(angles / self.rivals.noise_rad, noise)[:, noise.size :]
            cuts = [-M - self._plain, len(signals) - self._plain]
            of_sets, without, moved = np.split(signals, cuts)
            of_sets = of_sets.reshape(M, -1, signals.shape[1])
            mean = of_sets[:, 0]
            plain = (moved - mean[0]) / _DIFFERENCE
            spread = (of_sets[:, 1:] - mean[:, None]) / _DIFFERENCE
            yield mean, spread, self.trusted(mean - without, plain)

    def trusted(self, effect: Array, plain: Array) -> float:
        """Share of the evidence that a diagnosis trusts, by the gain of each set.

        A refit of the plain servo, with derivatives ``plain`` (B, n) by the logarithms of its
        parameters, takes up a part of the ``effect`` that sets have on the signals, (M, n).
        """
        across = effect @ plain.T
        taken = np.linalg.solve(np.eye(len(plain)) + plain @ plain.T, across.T).T
        left = np.sum(effect**2, axis=1) - np.sum(across * taken, axis=1)
        energy = self._gain + _fitted_noise(left, effect.shape[1]) / 2
        return float(1 / (1 + DECISION.law_error**2 * energy) @ self.probability)

    def _angles(self, commands: Array, rows: Array) -> list[Array]:
        """Angles of servos (B, P) for each command (N, T), in rad, one array (B, T) each."""
        plan = command_trace(self.context.load(self.rivals), commands[0], self.rivals.period_s)
        plan = replace(plan, supply_ratio=self.context.supply, gain_ratio=self.context.gain)
        simulator = Simulator([replace(plan, command=command) for command in commands])
        # one sub-step, so that differences of rows are smooth
        return simulator.angles(rows, coarse_substep(simulator.substeps(self._rows)).min())


def root_of_inverse(precision: Array) -> Array:
    """A matrix R with R R' = the inverse of a precision (F, F)."""
    scale = 1 / np.sqrt(np.diag(precision))
    value, vector = np.linalg.eigh(precision * np.outer(scale, scale))
    return np.asarray(scale[:, None] * vector / np.sqrt(np.maximum(value, 1e-10)))


def distances(mean: Array, spread: Array) -> Array:
    """Bhattacharyya distances of M sets, (M, M), by predictions (M, n) and spreads (M, F, n).

    All are NaN where a simulation diverged.
    """
    M, F, n = spread.shape
    columns = np.concatenate([mean - mean[0], spread.reshape(-1, n)])
    if not (np.abs(columns) < 1e7).all():
        return np.full((M, M), np.nan)
    products, of_set = columns @ columns.T, M + np.arange(M * F).reshape(M, F)
    i, j = np.triu_indices(M, 1)
    both = np.concatenate([of_set[i], of_set[j]], axis=1)
    across = products[both, i[:, None]] - products[both, j[:, None]]
    inner = np.eye(2 * F) + products[both[:, :, None], both[:, None, :]] / 2
    taken = np.einsum("pf,pf->p", across, np.linalg.solve(inner, across[..., None])[..., 0]) / 2
    square = products[i, i] - 2 * products[i, j] + products[j, j] - taken
    alone = np.linalg.slogdet(np.eye(F) + products[of_set[:, :, None], of_set[:, None, :]])[1]
    volume = np.linalg.slogdet(inner)[1] - (alone[i] + alone[j]) / 2
    out = np.zeros((M, M))
    out[i, j] = np.maximum(_fitted_noise(square, n) / 8 + volume / 2, 0.0)
    return np.asarray(out + out.T)


def _fitted_noise(square: Array, count: int) -> Array:
    """Twice the log-likelihood ratio, where the noise is fitted to what a set leaves, (P,)."""
    return np.asarray(count * np.log1p(np.maximum(square, 0.0) / max(count, 1)))


def remaining_entropy(probability: Array, distances: Array) -> Array:
    """Upper bound in nats, (N,), of the entropy over M sets, from (M,) and distances (N, M, M)."""
    with np.errstate(invalid="ignore"):
        overlap = np.exp(-distances) @ probability
        bound = np.log(overlap / probability) @ probability
    return np.where(np.isfinite(bound), bound, np.inf)
