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

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sim2real.arrays import Array, Index
from sim2real.design.contexts import AS_IT_IS, Context
from sim2real.design.information import command_trace, load_torque
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.rival_sets import JointRivals, RivalSet
from sim2real.diagnose.screening import NUISANCES
from sim2real.recording import PER_INERTIA
from sim2real.servo.batch import Batch, Problems
from sim2real.servo.parameters import COLUMNS, FIRST_EFFECT_COLUMN


class RivalObjective:
    """What commands tell of the sets of effects that are open on one joint.

    ``context``: what changes besides the commands; a root mean square of the torque beyond
    ``rms_torque_Nm`` is penalised. ``probability`` has those of the M sets, shape (M,).
    """

    def __init__(
        self, rivals: JointRivals, context: Context = AS_IT_IS, *, rms_torque_Nm: float = np.inf
    ) -> None:
        self.rivals, self.context = rivals, context
        known = context.load(rivals) is not PER_INERTIA
        self._torque2 = rms_torque_Nm**2 if known else np.inf
        self.probability = np.array([one.probability for one in rivals.sets])
        self._theta, self._vectors, self._spreads = _expansion(rivals)
        self._gain = np.array([one.gain for one in rivals.sets])

    def __call__(self, commands: Array) -> Array:
        """Minus the entropy in nats left by set-points (N, T) in rad, less a penalty, (N,)."""
        return self.scores(self.statistics(commands, 1)[:, 0])

    def statistics(self, commands: Array, parts: int) -> Array:
        """Sums over equal parts of commands (N, T), shape (N, parts, K * K + 2).

        Inner products of whitened predictions and derivatives, then the most probable set's squared
        torque over the number of samples, N2 m2, and the number of samples of the part.
        """
        N, load, batch = len(commands), self.context.load(self.rivals), self._batch(commands)
        rows = np.repeat(self._theta[None], N, axis=0)
        problems = Problems(np.arange(N, dtype=np.int32), rows, np.ones(rows.shape[:2]))
        noise, known = np.zeros((N, batch.lags)), self.rivals.autoregression[: batch.lags]
        noise[:, : known.size] = known
        seen = batch.evaluate(problems, blocks=parts, autoregression=noise, keep=True)
        assert seen.residual is not None
        with np.errstate(over="ignore"):  # of a simulation that diverges
            products = seen.gram.reshape(N, parts, -1) / self.rivals.noise_rad**2
        square = load_torque(load, seen.residual[:, 0], self.rivals.period_s) ** 2
        in_parts = np.array_split(square, parts, axis=1)
        torque2 = np.stack([part.sum(axis=1) for part in in_parts], axis=1) / commands.shape[1]
        count = np.broadcast_to([part.shape[1] for part in in_parts], torque2.shape)
        return np.concatenate([products, torque2[..., None], count[..., None]], axis=2)

    def scores(self, statistics: Array, *, penalty: float = 10.0) -> Array:
        """Scores (N,) of sums (N, K * K + 2); twice the allowed torque costs ``penalty`` nats."""
        excess = np.sqrt(statistics[:, -2] / self._torque2) - 1
        distances = self._distances(statistics)
        simulated = np.isfinite(distances).all(axis=(1, 2)) & np.isfinite(excess)
        left = remaining_entropy(self.probability, np.where(simulated[:, None, None], distances, 0))
        return np.where(simulated, -left - penalty * np.maximum(excess, 0.0), -np.inf)

    def distances(self, commands: Array) -> Array:
        """Bhattacharyya distances of all pairs of sets, shape (N, M, M); NaN where it diverges."""
        return self._distances(self.statistics(commands, 1)[:, 0])

    def _products(self, statistics: Array) -> Array:
        """Inner products (N, V, V) of what the vectors of ``_expansion`` combine, from sums."""
        grams = statistics[:, :-2].reshape(-1, len(self._theta), len(self._theta))
        return np.asarray(self._vectors.T @ grams @ self._vectors)

    def _distances(self, statistics: Array) -> Array:
        """Distances (N, M, M) from sums (N, K * K + 2); NaN where a simulation diverged."""
        M, F = self.probability.size, self._spreads
        diverged = np.logical_not(np.all(np.abs(statistics) < 1e14, axis=1))
        statistics = np.where(diverged[:, None], 0.0, statistics)
        products, count, used = self._products(statistics), statistics[:, -1], M * (1 + F)
        distance = distances(products[:, :used, :used], M, lambda x: _fitted_noise(x, count))
        distance = distance * self.trusted(statistics)[:, None, None]
        return np.where(diverged[:, None, None], np.nan, distance)

    def trusted(self, statistics: Array) -> Array:
        """Share of the evidence that a diagnosis trusts, from sums (N, K * K + 2), shape (N,)."""
        M, F, products = self.probability.size, self._spreads, self._products(statistics)
        bare = M * (1 + F) + np.arange(M)
        plain = np.tile(np.arange(M * (2 + F), products.shape[1]), (M, 1))
        square = _whitened(products, np.arange(M), bare, plain)[0]
        energy = self._gain + _fitted_noise(square, statistics[:, -1]) / 2
        return np.asarray(1 / (1 + DECISION.law_error**2 * energy) @ self.probability)

    def _batch(self, commands: Array) -> Batch:
        """The commands as if recorded, with all angles 0."""
        plan = command_trace(self.context.load(self.rivals), commands[0], self.rivals.period_s)
        plan = replace(plan, supply_ratio=self.context.supply, gain_ratio=self.context.gain)
        traces = [[replace(plan, command=command)] for command in commands]
        return Batch(traces, "cpu", 2, period=self.rivals.period_s)


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


def _expansion(rivals: JointRivals, *, step: float = 0.05) -> tuple[Array, Array, int]:
    """Rows to simulate (K, P), coefficients that give predictions and their spreads, and F.

    Rows: the sets, one a free parameter, the sets without their effects. Coefficients (K, M + M F +
    M + B): predictions of M sets; each set's derivatives times a root of the covariance, F columns;
    M without effects; derivatives by B parameters of a plain servo, times these.
    """
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
    without = [np.where(np.isin(_OWNERS, one.effects), 0.0, one.theta) for one in sets]
    theta = np.array(rows + without)
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
    return theta, vectors, F


_OWNERS = np.array([name.partition(".")[0] for name in COLUMNS])
"""Effect of each column of a row."""


def _free_columns(one: RivalSet) -> list[int]:
    """Columns of a set's free parameters without waves of the angle that every servo has."""
    alike = {effect.name for effect in NUISANCES} - set(one.effects)
    return [column for column in one.columns.tolist() if _OWNERS[column] not in alike]


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


def remaining_entropy(probability: Array, distances: Array) -> Array:
    """Upper bound in nats, (N,), of the entropy over M sets, from (M,) and distances (N, M, M)."""
    with np.errstate(invalid="ignore"):
        overlap = np.exp(-distances) @ probability
        entropy = np.log(overlap / probability) @ probability
    return np.where(np.isfinite(entropy), entropy, np.inf)
