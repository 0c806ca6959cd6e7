"""Commands that tell rival sets of effects apart: the entropy over sets that a recording leaves.

Each set of effects predicts the angles of a recording, with a covariance for what its parameters,
fitted to the recordings so far, may still be: y ~ N(m_i, I + U_i U_i'), whitened by the noise. The
columns of U_i are the derivatives of the angles by the parameters times a root of their covariance.
That is the setting of Box and Hill, Technometrics 9 (1967) 57-71. Two sets are as far apart as the
Bhattacharyya distance of their predictions,

    d_ij = r' S^-1 r / 8 + log(|S| / sqrt(|S_i| |S_j|)) / 2,   S = (S_i + S_j) / 2,  r = m_i - m_j,

in which refitted parameters take up what they can of the difference (Atkinson and Fedorov,
Biometrika 62 (1975) 57-70). With probabilities p the entropy that remains after the recording is at
most

    sum_i p_i log(sum_j p_j exp(-d_ij) / p_i)

by the bound of Kolchinsky and Tracey, Entropy 19 (2017) 361, eq. 10, with Chernoff's alpha = 1/2.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from sim2real.arrays import Array
from sim2real.design.contexts import AS_IT_IS, Context
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.rival_sets import JointRivals
from sim2real.servo.batch import Batch, Problems
from sim2real.servo.trace import Trace


class RivalObjective:
    """What commands tell of the sets of effects that are open on one joint.

    Args:
        rivals: The sets.
        context: What changes besides the commands.
        device: Warp device.
        threads: CPU threads.

    Attributes:
        probability: Probabilities of the M sets, shape (M,).
    """

    def __init__(
        self,
        rivals: JointRivals,
        context: Context = AS_IT_IS,
        *,
        device: str = "cpu",
        threads: int = 2,
    ) -> None:
        self.rivals, self.context = rivals, context
        self._device, self._threads = device, threads
        self.probability = np.array([one.probability for one in rivals.sets])
        self._expansion = _expansion(rivals)
        self._gain = np.array([one.gain for one in rivals.sets])

    def __call__(self, commands: Array) -> Array:
        """Minus the entropy that remains, in nats.

        Args:
            commands: Set-points in rad, shape (N, T), at the period of the recordings so far.

        Returns:
            Shape (N,); -inf where a simulation diverges.
        """
        return -remaining_entropy(self.probability, self.distances(commands))

    def distances(self, commands: Array) -> Array:
        """Bhattacharyya distances of all pairs of sets, shape (N, M, M); NaN where it diverges."""
        products = self._products(commands)
        M = len(self.rivals.sets)
        out = np.zeros((len(commands), M, M))
        for i, j in combinations(range(M), 2):
            out[:, i, j] = out[:, j, i] = self._distance(products, i, j)
        return out

    def difference(self, command: Array, i: int, j: int) -> Array:
        """Difference of two sets' predictions over time that refitted parameters leave, (T,).

        Args:
            command: Set-points in rad, shape (T,).
            i: Index of the first set.
            j: Index of the second set.

        Returns:
            S^-1 r of the module, in standard deviations of the noise.
        """
        theta = self._expansion.theta
        K = len(theta)
        batch = Batch(
            [[trace] for trace in self._staged(command[None])],
            self._device,
            1,
            period=self.rivals.period_s,
        )
        problems = Problems(np.zeros(K, dtype=np.int32), theta[:, None], np.zeros((K, 1)))
        noise = np.repeat(self._noise(batch)[None], K, axis=0)
        seen = batch.evaluate(problems, autoregression=noise, keep=True).whitened
        assert seen is not None
        vectors = (seen[:, 0] - seen[0, 0]).T / self.rivals.noise_rad
        means, spreads = self._expansion.means, self._expansion.spreads
        apart = vectors @ (means[:, i] - means[:, j])
        both = vectors @ np.hstack([spreads[i], spreads[j]]) / np.sqrt(2)
        inner = np.eye(both.shape[1]) + both.T @ both
        return np.asarray(apart - both @ np.linalg.solve(inner, both.T @ apart))

    def _noise(self, batch: Batch) -> Array:
        """Coefficients that whiten the noise, at the lags of a batch, shape (lags,)."""
        noise, known = np.zeros(batch.lags), self.rivals.autoregression[: batch.lags]
        noise[: known.size] = known
        return noise

    def _distance(self, products: Array, i: int, j: int) -> Array:
        """Distance of two sets, from inner products of all vectors (N, K, K), shape (N,).

        The law of an effect is wrong by ``law_error`` of its own size, see
        ``effect_probabilities.trusted_share``: that much of a difference does not count.
        """
        means, spreads = self._expansion.means, self._expansion.spreads
        difference = means[:, i] - means[:, j]
        both = np.hstack([spreads[i], spreads[j]]) / np.sqrt(2)
        apart, logdet = _quadratic(products, difference, both)
        single = [_logdet(products, spreads[k]) for k in (i, j)]
        distance = apart / 8 + (logdet - (single[0] + single[1]) / 2) / 2
        energy = np.maximum(self._gain[i], self._gain[j])
        return np.asarray(np.maximum(distance, 0.0) / (1 + DECISION.law_error**2 * energy))

    def _products(self, commands: Array) -> Array:
        """Inner products of predictions and derivatives, whitened, shape (N, K, K)."""
        N, expansion = len(commands), self._expansion
        theta = expansion.theta
        V = len(theta)
        batch = Batch(
            [[trace] for trace in self._staged(commands)],
            self._device,
            self._threads,
            period=self.rivals.period_s,
        )
        problems = Problems(
            np.arange(N, dtype=np.int32), np.repeat(theta[None], N, axis=0), np.ones((N, V))
        )
        noise = np.repeat(self._noise(batch)[None], N, axis=0)
        gram = batch.evaluate(problems, autoregression=noise).gram[:, 0]
        return np.asarray(gram / self.rivals.noise_rad**2)

    def _staged(self, commands: Array) -> list[Trace]:
        """The commands as if recorded, with all angles 0."""
        count = commands.shape[1]
        plan = Trace(
            name="next",
            file="next",
            t=self.rivals.period_s * np.arange(count, dtype=np.float64),
            command=np.zeros(count),
            position=np.zeros(count),
            load=self.context.load(self.rivals),
            used=np.ones(count, dtype=bool),
            supply_ratio=self.context.supply,
            gain_ratio=self.context.gain,
        )
        return [replace(plan, command=command) for command in commands]


@dataclass(frozen=True)
class _Expansion:
    """Rows to simulate, and how predictions and their spreads follow from them.

    Vectors are coefficients of the differences of the rows' angles from those of the first row.

    Attributes:
        theta: Parameter rows: those of the sets, then one a free parameter, shape (K, P).
        means: Predictions of the sets, shape (K, M).
        spreads: For each set its derivatives times a root of the covariance, shape (K, F).
    """

    theta: Array
    means: Array
    spreads: tuple[Array, ...]


def _expansion(rivals: JointRivals, *, step: float = 0.05) -> _Expansion:
    """Derivatives by each free parameter, at the most probable set that has it.

    Args:
        rivals: The sets.
        step: Step of the differences, in conditional standard deviations of the parameter.
    """
    sets, M = rivals.sets, len(rivals.sets)
    owner: dict[int, int] = {}
    for i, one in enumerate(sets):
        for column in one.columns.tolist():
            owner.setdefault(column, i)
    columns = list(owner)
    K = M + len(columns)
    theta = np.array([one.theta for one in sets] + [sets[i].theta for i in owner.values()])
    derivatives = np.zeros((K, len(columns)))
    for n, (column, i) in enumerate(owner.items()):
        one = sets[i]
        place = int(np.flatnonzero(one.columns == column)[0])
        size = step / np.sqrt(one.information[place, place])
        theta[M + n, column] += size
        derivatives[M + n, n], derivatives[i, n] = 1 / size, -1 / size
    derivatives[0] = 0.0  # differences from the first row
    spreads = []
    for one in sets:
        of_set = derivatives[:, [columns.index(c) for c in one.columns.tolist()]]
        spreads.append(of_set @ _root_of_inverse(one.information))
    means = np.eye(K, M)
    means[0] = 0.0
    return _Expansion(theta, means, tuple(spreads))


def _root_of_inverse(precision: Array) -> Array:
    """A matrix R with R R' = the inverse of a precision (F, F)."""
    scale = 1 / np.sqrt(np.diag(precision))
    value, vector = np.linalg.eigh(precision * np.outer(scale, scale))
    return np.asarray(scale[:, None] * vector / np.sqrt(np.maximum(value, 1e-10)))


def _quadratic(products: Array, difference: Array, spread: Array) -> tuple[Array, Array]:
    """R' (I + V V')^-1 r and the logarithm of the determinant, for N recordings, shapes (N,)."""
    along = products @ difference
    square = along @ difference
    inner = np.eye(spread.shape[1]) + spread.T @ (products @ spread)
    across = along @ spread
    taken = np.linalg.solve(inner, across[:, :, None])[:, :, 0]
    return square - np.einsum("nf,nf->n", across, taken), np.linalg.slogdet(inner)[1]


def _logdet(products: Array, spread: Array) -> Array:
    """Logarithm of the determinant of I + U U', shape (N,)."""
    inner = np.eye(spread.shape[1]) + spread.T @ (products @ spread)
    return np.asarray(np.linalg.slogdet(inner)[1])


def remaining_entropy(probability: Array, distances: Array) -> Array:
    """Upper bound of the entropy over M sets after a recording, in nats, shape (N,).

    Args:
        probability: Probabilities of the sets before it, shape (M,).
        distances: Bhattacharyya distances of their predictions, shape (N, M, M); infinite entropy
            where one is NaN.
    """
    with np.errstate(invalid="ignore"):
        overlap = np.exp(-distances) @ probability
        entropy = np.log(overlap / probability) @ probability
    return np.where(np.isfinite(entropy), entropy, np.inf)
