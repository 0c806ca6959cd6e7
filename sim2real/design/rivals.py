"""Commands that tell rival sets of effects apart: the entropy over sets that a recording leaves.

Each set of effects predicts the angles of a recording, with a covariance for what its parameters,
fitted to the recordings so far, may still be: y ~ N(m_i, I + U_i U_i'), whitened by the noise (Box
and Hill, Technometrics 9 (1967) 57-71). Two sets are as far apart as the Bhattacharyya distance

    d_ij = r' S^-1 r / 8 + log(|S| / sqrt(|S_i| |S_j|)) / 2,   S = (S_i + S_j) / 2,  r = m_i - m_j,

in which refitted parameters take up what they can of the difference (Atkinson and Fedorov,
Biometrika 62 (1975) 57-70). With probabilities p the entropy that remains is at most

    sum_i p_i log(sum_j p_j exp(-d_ij) / p_i)

(Kolchinsky and Tracey, Entropy 19 (2017) 361, eq. 10, with Chernoff's alpha = 1/2). A diagnosis
fits the noise to what a set leaves: the evidence of n samples against the wrong set is at most
n/2 log(1 + r'r / n) (Kolmogorov's formula: Brockwell and Davis, Time Series, 1991, section 5.8, and
Jensen's inequality), which stands for r'r / 2 here. The law of an effect is wrong by a share q of
its own response, so that a diagnosis trusts a share 1 / (1 + q**2 E) of the evidence
(``effect_probabilities.trusted_share``), with E half the energy that a refitted plain servo leaves
of a set's effects, summed over all recordings. Distances are multiplied by its mean over sets.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from sim2real.arrays import Array, Index
from sim2real.design.contexts import AS_IT_IS, Context
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.rival_sets import JointRivals, RivalSet
from sim2real.diagnose.screening import NUISANCES
from sim2real.recording import PER_INERTIA
from sim2real.servo.batch import Batch, Problems
from sim2real.servo.parameters import COLUMNS, FIRST_EFFECT_COLUMN
from sim2real.servo.trace import Trace


class RivalObjective:
    """What commands tell of the sets of effects that are open on one joint.

    Args:
        rivals: The sets.
        context: What changes besides the commands.
        rms_torque_Nm: Largest root mean square of the torque; what exceeds it is penalised.

    Attributes:
        probability: Probabilities of the M sets, shape (M,).
    """

    def __init__(
        self, rivals: JointRivals, context: Context = AS_IT_IS, *, rms_torque_Nm: float = np.inf
    ) -> None:
        self.rivals, self.context = rivals, context
        known = context.load(rivals) is not PER_INERTIA
        self._torque2 = rms_torque_Nm**2 if known else np.inf
        self.probability = np.array([one.probability for one in rivals.sets])
        self._expansion = _expansion(rivals)
        self._gain = np.array([one.gain for one in rivals.sets])

    def __call__(self, commands: Array) -> Array:
        """Minus the entropy that remains, in nats, less a penalty for too much torque.

        Of set-points (N, T) in rad at the period of the recordings so far; shape (N,), -inf where a
        simulation diverges.
        """
        return self.scores(self.statistics(commands, 1)[:, 0])

    def statistics(self, commands: Array, parts: int) -> Array:
        """Sums over equal parts of commands (N, T), shape (N, parts, K * K + 2).

        Inner products of whitened predictions and derivatives, then the most probable set's squared
        torque over the number of samples, N2 m2, and the number of samples of the part.
        """
        N, theta = len(commands), self._expansion.theta
        batch = self._batch(commands, threads=2)
        rows = np.repeat(theta[None], N, axis=0)
        problems = Problems(np.arange(N, dtype=np.int32), rows, np.ones(rows.shape[:2]))
        noise = np.repeat(self._noise(batch)[None], N, axis=0)
        seen = batch.evaluate(problems, blocks=parts, autoregression=noise, keep=True)
        assert seen.residual is not None
        with np.errstate(over="ignore"):  # of a simulation that diverges
            products = seen.gram.reshape(N, parts, -1) / self.rivals.noise_rad**2
        square = self._torque(seen.residual[:, 0]) ** 2
        in_parts = np.array_split(square, parts, axis=1)
        torque2 = np.stack([part.sum(axis=1) for part in in_parts], axis=1) / commands.shape[1]
        count = np.broadcast_to([part.shape[1] for part in in_parts], torque2.shape)
        return np.concatenate([products, torque2[..., None], count[..., None]], axis=2)

    def _torque(self, angle: Array) -> Array:
        """Torque that moves the load along angles (N, T), N m, same shape."""
        load = self.context.load(self.rivals)
        acceleration = np.zeros_like(angle)
        acceleration[:, 1:-1] = np.diff(angle, 2, axis=1) / self.rivals.period_s**2
        return np.asarray(load.inertia_kgm2 * acceleration + load.gravity_Nm * np.sin(angle))

    def scores(self, statistics: Array, *, penalty: float = 10.0) -> Array:
        """Scores of N commands from their sums (N, K * K + 2), shape (N,).

        A torque of twice what is allowed costs ``penalty`` nats.
        """
        excess = np.sqrt(statistics[:, -2] / self._torque2) - 1
        distances = self._distances(statistics)
        simulated = np.isfinite(distances).all(axis=(1, 2)) & np.isfinite(excess)
        left = remaining_entropy(self.probability, np.where(simulated[:, None, None], distances, 0))
        return np.where(simulated, -left - penalty * np.maximum(excess, 0.0), -np.inf)

    def distances(self, commands: Array) -> Array:
        """Bhattacharyya distances of all pairs of sets, shape (N, M, M); NaN where it diverges."""
        return self._distances(self.statistics(commands, 1)[:, 0])

    def trusted(self, commands: Array) -> Array:
        """Share of the evidence that a diagnosis is expected to trust, shape (N,)."""
        statistics = self.statistics(commands, 1)[:, 0]
        return self._trusted(self._products(statistics), statistics[:, -1])

    def _products(self, statistics: Array) -> Array:
        """Inner products (N, V, V) of what ``_Derivatives.vectors`` combine, from all sums."""
        vectors = self._expansion.vectors
        K = len(vectors)
        return np.asarray(vectors.T @ statistics[:, :-2].reshape(-1, K, K) @ vectors)

    def _distances(self, statistics: Array) -> Array:
        """Distances (N, M, M) from sums (N, K * K + 2); NaN where a simulation diverged."""
        M, F = self.probability.size, self._expansion.spreads
        diverged = np.logical_not(np.all(np.abs(statistics) < 1e14, axis=1))
        products = self._products(np.where(diverged[:, None], 0.0, statistics))
        count, used = statistics[:, -1], M * (1 + F)
        distance = distances(products[:, :used, :used], M, lambda x: _fitted_noise(x, count))
        distance = distance * self._trusted(products, count)[:, None, None]
        return np.where(diverged[:, None, None], np.nan, distance)

    def _trusted(self, products: Array, count: Array) -> Array:
        """Share of the evidence that counts, (N,), from inner products (N, V, V)."""
        M, F = self.probability.size, self._expansion.spreads
        bare = M * (1 + F) + np.arange(M)
        plain = np.tile(np.arange(M * (2 + F), products.shape[1]), (M, 1))
        square = _whitened(products, np.arange(M), bare, plain)[0]
        energy = self._gain + _fitted_noise(square, count) / 2
        return np.asarray(1 / (1 + DECISION.law_error**2 * energy) @ self.probability)

    def difference(self, command: Array, i: int, j: int) -> Array:
        """Difference over time of the predictions of sets i and j that refitted parameters leave.

        S^-1 r of the module for set-points (T,) in rad, in standard deviations of the noise, (T,).
        """
        theta = self._expansion.theta
        K = len(theta)
        batch = self._batch(command[None], threads=1)
        problems = Problems(np.zeros(K, dtype=np.int32), theta[:, None], np.zeros((K, 1)))
        noise = np.repeat(self._noise(batch)[None], K, axis=0)
        seen = batch.evaluate(problems, autoregression=noise, keep=True).whitened
        assert seen is not None
        vectors = (seen[:, 0] - seen[0, 0]).T / self.rivals.noise_rad
        M, F = self.probability.size, self._expansion.spreads
        means, spreads, _ = np.split(self._expansion.vectors, [M, M * (1 + F)], axis=1)
        of_set = np.split(spreads, M, axis=1)
        both = vectors @ np.hstack([of_set[i], of_set[j]])
        return left_by_refits(vectors @ (means[:, i] - means[:, j]), both)

    def _noise(self, batch: Batch) -> Array:
        """Coefficients that whiten the noise, at the lags of a batch, shape (lags,)."""
        noise, known = np.zeros(batch.lags), self.rivals.autoregression[: batch.lags]
        noise[: known.size] = known
        return noise

    def _batch(self, commands: Array, threads: int) -> Batch:
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
        traces = [[replace(plan, command=command)] for command in commands]
        return Batch(traces, "cpu", threads, period=self.rivals.period_s)


def _whitened(
    products: Array, i: Index, j: Index, spread: Index, share: float = 1.0
) -> tuple[Array, Array]:
    """Squares r' S^-1 r of P differences r, and log |S|, with S = I + share U U', both (N, P)."""
    square = products[:, i, i] - 2 * products[:, i, j] + products[:, j, j]
    across = products[:, spread, i[:, None]] - products[:, spread, j[:, None]]
    inner = products[:, spread[:, :, None], spread[:, None, :]]
    inner = np.eye(spread.shape[1]) + share * inner
    taken = np.linalg.solve(inner, across[..., None])[..., 0]
    square = square - share * np.einsum("npf,npf->np", across, taken)
    return square, np.linalg.slogdet(inner)[1]


def _fitted_noise(square: Array, count: Array) -> Array:
    """Twice the log-likelihood ratio, where the noise is fitted to what a set leaves, (N, P)."""
    mean = np.maximum(square, 0.0) / np.maximum(count[:, None], 1)
    return np.asarray(count[:, None] * np.log1p(mean))


@dataclass(frozen=True)
class _Derivatives:
    """Rows to simulate, and how predictions and their spreads follow from them."""

    # parameter rows: those of the sets, then one a free parameter, then those of the sets without
    # their effects, shape (K, P)
    theta: Array
    # coefficients of the differences of the rows' angles from those of the first row: the
    # predictions of the M sets, then for each set its derivatives times a root of the covariance,
    # padded to F columns, then the M predictions without effects, and the derivatives by the B
    # parameters of a plain servo times these parameters, shape (K, M + M F + M + B)
    vectors: Array
    spreads: int  # F


def _expansion(rivals: JointRivals, *, step: float = 0.05) -> _Derivatives:
    """Derivatives by each free parameter, at the most probable set that has it."""
    sets, M = rivals.sets, len(rivals.sets)
    free = [_free_columns(one) for one in sets]
    owner: dict[int, int] = {}
    for i, columns in enumerate(free):
        for column in columns:
            owner.setdefault(column, i)
    place = {column: n for n, column in enumerate(owner)}
    bare = M + len(owner) + np.arange(M)
    K = M + len(owner) + M
    rows = [one.theta for one in sets] + [sets[i].theta for i in owner.values()]
    theta = np.array(rows + [_without_effects(one) for one in sets])
    derivatives = np.zeros((K, len(owner)))
    for (column, i), n in zip(owner.items(), place.values(), strict=True):
        at = sets[i].columns.tolist().index(column)
        size = step / np.sqrt(sets[i].information[at, at])
        theta[M + n, column] += size
        derivatives[M + n, n], derivatives[i, n] = 1 / size, -1 / size
    derivatives[0] = 0.0  # differences from the first row
    F = max(len(columns) for columns in free)
    plain = [column for column in owner if column < FIRST_EFFECT_COLUMN]
    vectors = np.zeros((K, M + M * F + M + len(plain)))
    vectors[range(1, M), range(1, M)] = 1.0
    vectors[bare, M * (1 + F) + np.arange(M)] = 1.0
    for n, column in enumerate(plain, start=M * (2 + F)):
        vectors[:, n] = derivatives[:, place[column]] * theta[M + place[column], column]
    for i, (one, columns) in enumerate(zip(sets, free, strict=True)):
        kept = [one.columns.tolist().index(column) for column in columns]
        root = _root(one.information)[kept]
        left, size, _ = np.linalg.svd(root, full_matrices=False)
        spread = derivatives[:, [place[column] for column in columns]] @ (left * size)
        vectors[:, M + i * F : M + i * F + len(columns)] = spread
    return _Derivatives(theta, vectors, F)


def _without_effects(one: RivalSet) -> Array:
    """Parameters of a set's servo without its effects, shape (P,)."""
    owners = np.array([name.partition(".")[0] for name in COLUMNS])
    return np.where(np.isin(owners, one.effects), 0.0, one.theta)


def _free_columns(one: RivalSet) -> list[int]:
    """Columns of a set's free parameters without waves of the angle that every servo has."""
    owners = [COLUMNS[column].partition(".")[0] for column in one.columns]
    alike = {effect.name for effect in NUISANCES} - set(one.effects)
    pairs = zip(one.columns.tolist(), owners, strict=True)
    return [column for column, owner in pairs if owner not in alike]


def _root(precision: Array) -> Array:
    """A matrix R with R R' = the inverse of a precision (F, F)."""
    scale = 1 / np.sqrt(np.diag(precision))
    value, vector = np.linalg.eigh(precision * np.outer(scale, scale))
    return np.asarray(scale[:, None] * vector / np.sqrt(np.maximum(value, 1e-10)))


def distances(products: Array, M: int, evidence: Callable[[Array], Array] = np.asarray) -> Array:
    """Bhattacharyya distances of the predictions of M sets, shape (N, M, M).

    From inner products (N, M + M F, M + M F) of the whitened predictions m_i of the sets and the
    columns of their spreads U_i, one set after the other, each of F columns. ``evidence`` returns
    what counts in the place of the squares r' S^-1 r.
    """
    F = products.shape[1] // M - 1
    i, j = np.triu_indices(M, 1)
    sets, of_set = np.arange(M), M + np.arange(M * F).reshape(M, F)
    both = np.concatenate([of_set[i], of_set[j]], axis=1)
    square, logdet = _whitened(products, i, j, both, 0.5)
    alone = _whitened(products, sets, sets, of_set)[1]
    distance = evidence(square) / 8 + (logdet - (alone[:, i] + alone[:, j]) / 2) / 2
    out = np.zeros((len(products), M, M))
    out[:, i, j] = np.maximum(distance, 0.0)
    return np.asarray(out + out.transpose(0, 2, 1))


def left_by_refits(difference: Array, spreads: Array) -> Array:
    """The part S^-1 r of a difference of two whitened predictions (n,) that refits leave, (n,).

    ``spreads`` has the columns U_i and U_j of both sets, shape (n, 2 F).
    """
    both = spreads / np.sqrt(2)
    inner = np.eye(both.shape[1]) + both.T @ both
    return np.asarray(difference - both @ np.linalg.solve(inner, both.T @ difference))


def remaining_entropy(probability: Array, distances: Array) -> Array:
    """Upper bound of the entropy over M sets after a recording, in nats, shape (N,).

    From probabilities (M,) before it and Bhattacharyya distances (N, M, M) of their predictions;
    infinite where one is NaN.
    """
    with np.errstate(invalid="ignore"):
        overlap = np.exp(-distances) @ probability
        entropy = np.log(overlap / probability) @ probability
    return np.where(np.isfinite(entropy), entropy, np.inf)
