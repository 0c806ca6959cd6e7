"""Search of sets of effects: forward, swap, prune, every set refitted with the gains."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from sim2real.diagnose.candidates import REFITTED, RIPPLE, Candidate, candidate
from sim2real.diagnose.screen import Screen, screen
from sim2real.effects import named
from sim2real.servo.batch import Batch, Problems
from sim2real.servo.parameters import COLUMNS
from sim2real.servo.problem import Fits, Servos, minimise
from sim2real.servo.start import DAMPING_RATIO, FREQUENCY_RAD_S, LATENCY_S, natural_units

Array = NDArray[np.float64]
Set = frozenset[str]

PRIOR_SD = 2.0
"""Prior standard deviation of an effect's parameter, in typical values."""
LOG_PRIOR = float(np.log(0.5 / len(REFITTED)))
"""Logarithm of the prior odds of each effect: half of all joints miss one."""
MOST_EFFECTS = 4
SURELY = 25.0
"""A gain that is never left to chance, however uneven the noise."""
BLOCKS = 20
"""Blocks of each recording for bootstraps."""
_CANDIDATES = 256
_REFINED = 3
_BETTER = 1.0
_ADDED, _RIVALS, _RIVAL_GAP = 6, 3, 12.0


@dataclass(frozen=True)
class Hypothesis:
    """One set of effects, fitted to one joint.

    Attributes:
        effects: The effects.
        fit: One fit.
        evidence: Logarithm of the marginal likelihood and prior, up to a constant of the joint.
    """

    effects: Set
    fit: Fits
    evidence: float


@dataclass
class Book:
    """Everything that was tried on one joint."""

    joint: int
    base: Set
    tried: dict[Set, Hypothesis] = field(default_factory=dict)
    screens: dict[Set, Screen] = field(default_factory=dict)
    starts: dict[Set, list[Candidate]] = field(default_factory=dict)

    @property
    def plain(self) -> Hypothesis:
        """The servo with what the given model has, and nothing else."""
        return self.tried[self.base]

    @property
    def best(self) -> Hypothesis:
        """The set of the largest evidence."""
        return max(self.tried.values(), key=lambda h: h.evidence)


def baselines(batch: Batch, models: Array | None = None) -> Fits:
    """Fit the plain servo to every joint of a batch, with no guess by hand.

    Args:
        batch: The recordings.
        models: Parameter rows to start from as well, shape (joints, P), NaN where there is none.
    """
    J = batch.recordings.size
    points = qmc.Sobol(3, seed=0).random(_CANDIDATES)
    ranges = np.array([np.log(FREQUENCY_RAD_S), np.log(DAMPING_RATIO), LATENCY_S])
    scaled = ranges[:, 0] + points * np.diff(ranges, axis=1).T
    frequency, damping = np.exp(scaled[:, :2]).T
    inertia = batch.load[batch.first_signal, 0]
    theta = np.zeros((J, _CANDIDATES, len(COLUMNS)))
    theta[:, :, 0] = inertia[:, None] * frequency**2
    theta[:, :, 1] = inertia[:, None] * 2 * damping * frequency
    theta[:, :, 2] = scaled[:, 2]
    joint = np.repeat(np.arange(J, dtype=np.int32), _CANDIDATES)
    rows = theta.reshape(-1, 1, len(COLUMNS))
    white = np.zeros((joint.size, batch.lags))
    seen = batch.evaluate(Problems(joint, rows, np.zeros(rows.shape[:2])), autoregression=white)
    error2 = seen.square[:, 0].reshape(J, _CANDIDATES)
    best = np.argsort(error2, axis=1)[:, :6]
    starts = np.take_along_axis(theta, best[:, :, None], axis=1)
    if models is not None:
        given = np.where(np.isfinite(models), models, starts[:, 0])
        starts = np.concatenate([starts, given[:, None]], axis=1)
        starts[:, :, 5:] = given[:, None, 5:]
    K = starts.shape[1]
    many = _servos(np.repeat(np.arange(J), K), starts.reshape(J * K, -1), batch)
    rough = minimise(batch, many, iterations=12, white=True)
    order = np.argsort(rough.error2.reshape(J, K), axis=1)[:, :_REFINED]
    pick = (np.arange(J)[:, None] * K + order).ravel()
    fine = minimise(batch, rough[pick].servos, iterations=12, blocks=BLOCKS)
    best = fine.error2.reshape(J, -1).argmin(axis=1)
    return fine[np.arange(J) * order.shape[1] + best]


def _servos(joint: NDArray[np.int64], theta: Array, batch: Batch) -> Servos:
    """Plain servos with free gains and latency."""
    inertia = batch.load[batch.first_signal[joint], 0]
    unit = np.array(
        [
            natural_units(np.append(row[:3], 0.0), i)[:3]
            for row, i in zip(theta, inertia, strict=True)
        ]
    )
    # Samples cannot tell what rings faster than half their rate from what is slower.
    fastest2 = min(1.6e5, (np.pi / batch.period) ** 2)
    high = np.stack([fastest2 * inertia, 1.6e3 * inertia, np.full(inertia.size, 0.5)], axis=1)
    low = np.stack([1e-3 * inertia, np.zeros(inertia.size), np.zeros(inertia.size)], axis=1)
    columns = np.tile(np.arange(3, dtype=np.int32), (joint.size, 1))
    return Servos(joint.astype(np.int32), theta, columns, unit, low, high)


def search(
    batch: Batch,
    plain: Fits,
    *,
    level: float,
    rng: np.random.Generator,
    bases: Sequence[Set] | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> list[Book]:
    """Try sets of effects on every joint until none is better.

    Args:
        batch: The recordings.
        plain: The fit of the plain servo, one a joint.
        level: Share of joints with nothing missing that may be searched beyond single effects.
        rng: For the bootstrap.
        bases: Effects that each joint's given model has.
        progress: Called with the share that is done.
    """
    J = plain.count.size
    books = [Book(j, bases[j] if bases else frozenset()) for j in range(J)]
    for j, book in enumerate(books):
        fit = plain[np.array([j])]
        book.tried[book.base] = Hypothesis(book.base, fit, _evidence(fit, frozenset())[0])
    _try_singles(batch, books)
    _try_singles(batch, _rebased(batch, books))
    progress(0.4)
    open_books = [book for book in books if remains(book, book.base, level, rng)]
    for round_ in range(MOST_EFFECTS - 1):
        before = {book.joint: book.best.effects for book in open_books}
        _extend(batch, open_books, level, rng)
        open_books = [book for book in open_books if book.best.effects != before[book.joint]]
        progress(0.4 + 0.6 * (round_ + 1) / (MOST_EFFECTS - 1))
        if not open_books:
            break
    progress(1.0)
    return books


def _try_singles(batch: Batch, books: list[Book]) -> None:
    """Refit every effect by itself."""
    _look(batch, [(book, book.base) for book in books])
    singles = [
        (book, book.base | {name}, start)
        for book in books
        for name, start in _best_starts(book, book.base, each=2, most=None)
    ]
    _try(batch, singles)


def _rebased(batch: Batch, books: list[Book]) -> list[Book]:
    """Books whose plain servo fits better with the gains that the best single effect has found."""
    before = {book.joint: book.plain.evidence for book in books}
    _try(batch, [(book, book.base, book.best.fit.servos.theta[0]) for book in books])
    return [book for book in books if book.plain.evidence > before[book.joint] + _BETTER]


def remains(book: Book, effects: Set, level: float, rng: np.random.Generator) -> bool:
    """Whether some effect would still explain more than chance.

    Ripple does not count: every gear train has some, and it is named only where it is large.
    """
    counted = np.array([c.effect.name != RIPPLE for c in book.starts[effects]])
    seen = book.screens[effects].of(counted)
    return float(seen.gain.max()) > min(seen.threshold(level, rng), SURELY)


def _extend(batch: Batch, books: list[Book], level: float, rng: np.random.Generator) -> None:
    """Add to the best sets, swap their members, leave one out."""
    look = [(book, effects) for book in books for effects in _promising(book)]
    smaller = [(book, book.best.effects - {e}) for book in books for e in book.best.effects]
    smaller = [(b, s) for b, s in smaller if s >= b.base]
    missing = [(b, s, b.best.fit.servos.theta[0]) for b, s in smaller if s not in b.tried]
    _try(batch, missing)
    _look(batch, [(b, s) for b, s in [*look, *smaller] if s not in b.screens])
    jobs = []
    for book, effects in look:
        if len(effects) - len(book.base) < MOST_EFFECTS and remains(book, effects, level, rng):
            jobs += [
                (book, effects | {name}, start)
                for name, start in _best_starts(book, effects, each=1, most=_ADDED)
            ]
    for book, effects in smaller:
        jobs += [
            (book, effects | {name}, start)
            for name, start in _best_starts(book, effects, each=1, most=_ADDED)
        ]
    _try(batch, [job for job in jobs if job[1] not in job[0].tried])


def _promising(book: Book) -> list[Set]:
    """The best set and its closest rivals of the same size."""
    best = book.best
    order = sorted(book.tried.values(), key=lambda h: -h.evidence)
    return [
        h.effects
        for h in order
        if len(h.effects) == len(best.effects) and h.evidence > best.evidence - _RIVAL_GAP
    ][:_RIVALS]


def _look(batch: Batch, where: list[tuple[Book, Set]]) -> None:
    """Screen all other effects from each of these sets; sets of one size share a launch."""
    for size in sorted({book.tried[s].fit.servos.columns.shape[1] for book, s in where}):
        some = [x for x in where if x[0].tried[x[1]].fit.servos.columns.shape[1] == size]
        fits = joined([book.tried[s].fit for book, s in some])
        lists = [_candidates(book, s, batch) for book, s in some]
        for (book, s), seen, given in zip(
            some, screen(batch, fits, lists, blocks=BLOCKS), lists, strict=True
        ):
            book.screens[s], book.starts[s] = seen, given


def _candidates(book: Book, effects: Set, batch: Batch) -> list[Candidate]:
    """Every effect that is not in a set, for this joint's strength."""
    kp = float(book.plain.fit.servos.theta[0, 0])
    inertia = float(batch.load[batch.first_signal[book.joint], 0])
    families = {named(name).family for name in effects} - {""}
    return [
        candidate(e, kp, inertia)
        for e in REFITTED
        if e.name not in effects and e.family not in families
    ]


def _best_starts(
    book: Book, effects: Set, *, each: int, most: int | None
) -> list[tuple[str, Array]]:
    """For the effects that explain most from a set, their best starts: name and parameter row."""
    seen, given = book.screens[effects], book.starts[effects]
    gain = seen.gain
    chosen: list[tuple[float, str, Array]] = []
    for k, option in enumerate(given):
        mine = np.flatnonzero(seen.candidate == k)
        mine = mine[np.argsort(-gain[mine])][:each]
        for index in mine:
            theta = book.tried[effects].fit.servos.theta[0].copy()
            theta[option.columns] = option.starts[seen.start[index]]
            chosen.append((float(gain[index]), option.effect.name, theta))
    chosen.sort(key=lambda entry: -entry[0])
    return [(name, theta) for _, name, theta in chosen[: most and most * each]]


def _try(batch: Batch, jobs: list[tuple[Book, Set, Array]]) -> None:
    """Refit sets of effects from given parameter rows; the best of several starts is kept."""
    if not jobs:
        return
    servos = [_with_effects(book, effects, theta, batch) for book, effects, theta in jobs]
    width = max(s.columns.shape[1] for s in servos)
    stacked = _stacked([_padded(s, width) for s in servos])
    rough = minimise(batch, stacked, iterations=5)
    best: dict[tuple[int, Set], int] = {}
    error2 = rough.error2
    for k, (book, effects, _) in enumerate(jobs):
        key = (book.joint, effects)
        if key not in best or error2[k] < error2[best[key]]:
            best[key] = k
    index = np.array(list(best.values()))
    fine = minimise(batch, rough.servos[index], iterations=15, blocks=BLOCKS)
    for n, k in enumerate(index):
        book, effects, _ = jobs[k]
        one = _trimmed(fine, n)
        evidence = _evidence(one, effects - book.base)[0]
        if effects not in book.tried or evidence > book.tried[effects].evidence:
            book.tried[effects] = Hypothesis(effects, one, evidence)


def _with_effects(book: Book, effects: Set, theta: Array, batch: Batch) -> Servos:
    """A servo with free gains, latency and parameters of effects."""
    plain = book.plain.fit.servos
    base = [name for name in sorted(effects)]
    kp = float(plain.theta[0, 0])
    inertia = float(batch.load[batch.first_signal[book.joint], 0])
    given = [candidate(named(name), kp, inertia) for name in base]
    row = np.zeros_like(theta)
    row[:5] = theta[:5]
    for option in given:
        row[option.columns] = theta[option.columns]
    return Servos(
        plain.joint,
        row[None],
        np.concatenate([np.arange(3, dtype=np.int32), *(c.columns for c in given)])[None],
        np.concatenate([plain.unit[0, :3], *(c.unit for c in given)])[None],
        np.concatenate([plain.low[0, :3], *(c.low for c in given)])[None],
        np.concatenate([plain.high[0, :3], *(c.high for c in given)])[None],
    )


def _padded(servos: Servos, width: int) -> Servos:
    more = ((0, 0), (0, width - servos.columns.shape[1]))
    return Servos(
        servos.joint,
        servos.theta,
        np.pad(servos.columns, more, constant_values=-1),
        np.pad(servos.unit, more, constant_values=1.0),
        np.pad(servos.low, more),
        np.pad(servos.high, more),
    )


def _trimmed(fits: Fits, n: int) -> Fits:
    """One fit without the places that hold no parameter."""
    one = fits[np.array([n])]
    width = int(one.servos.free.sum())
    s = one.servos
    servos = Servos(
        s.joint,
        s.theta,
        s.columns[:, :width],
        s.unit[:, :width],
        s.low[:, :width],
        s.high[:, :width],
    )
    gram = one.gram[:, :, : 1 + width, : 1 + width]
    return Fits(servos, gram, one.count, one.autoregression)


def _stacked(servos: Sequence[Servos]) -> Servos:
    columns = zip(*(vars(s).values() for s in servos), strict=True)
    return Servos(*(np.concatenate(values) for values in columns))


def joined(fits: Sequence[Fits]) -> Fits:
    """Fits of any numbers of parameters as one; those of fewer are padded."""
    width = max(fit.servos.columns.shape[1] for fit in fits)
    more = [width - fit.servos.columns.shape[1] for fit in fits]
    return Fits(
        _stacked([_padded(fit.servos, width) for fit in fits]),
        np.concatenate(
            [
                np.pad(fit.gram, ((0, 0), (0, 0), (0, m), (0, m)))
                for fit, m in zip(fits, more, strict=True)
            ]
        ),
        np.concatenate([fit.count for fit in fits]),
        np.concatenate([fit.autoregression for fit in fits]),
    )


def _evidence(fits: Fits, added: Set) -> Array:
    """Laplace's approximation of the evidence of effects, shape (N,).

    log p(data | best fit) - 1/2 log det(1 + prior variance x information), the information being
    what gains and latency leave of it, plus the log prior. Source: MacKay, Information Theory,
    Inference, and Learning Algorithms (Cambridge, 2003), ch. 28.
    """
    total = fits.gram.sum(axis=1)
    variance = fits.error2 / fits.count
    base, normal = total[:, 1:4, 1:4], total[:, 4:, 4:]
    cross = total[:, 1:4, 4:]
    inverse = np.linalg.pinv(base, rcond=1e-10, hermitian=True)
    left = normal - np.einsum("nfa,nfg,ngb->nab", cross, inverse, cross)
    matrix = np.eye(left.shape[1]) + PRIOR_SD**2 * left / variance[:, None, None]
    occam = 0.5 * np.linalg.slogdet(matrix)[1] if left.shape[1] else 0.0
    return np.asarray(fits.loglikelihood - occam + len(added) * LOG_PRIOR)
