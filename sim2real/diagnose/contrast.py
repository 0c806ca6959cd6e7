"""How much more of a case a change explains than where nothing has changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sim2real.arrays import Array, Mask
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.explained import DIFFERENCE, GAINS, Explained
from sim2real.diagnose.screening import candidate, candidates
from sim2real.effects import named
from sim2real.inference.evidence import student
from sim2real.inference.least_squares import Expansion, expansion, minimise, stacked
from sim2real.servo.parameters import COLUMNS
from sim2real.structured import Fields, read_json

BANK = Path(__file__).with_name("unchanged.json")


@dataclass(frozen=True)
class Unchanged:
    """What recordings look like in which nothing has changed, by the way they are explained."""

    known: float  # how many of them there are
    # null size of each effect, mean squares over the references' residual
    null: Mapping[str, float]
    jump: float  # largest step of the residual, over the references', that is no sign of anything


def _read_bank() -> dict[str, Unchanged]:
    ways = Fields(BANK, "", read_json(BANK, "sim2real.unchanged/1")).table("ways")
    entries = {way: ways.table(way) for way in ways.content}
    nulls = {way: entry.table("null") for way, entry in entries.items()}
    return {
        way: Unchanged(
            entry.number("known"),
            {name: nulls[way].number(name) for name in nulls[way].content},
            entry.number("jump"),
        )
        for way, entry in entries.items()
    }


BANKS = _read_bank()
"""Recordings in which nothing has changed, as ``benchmarks/unchanged_bank.py`` found them."""


@dataclass(frozen=True)
class Directions:
    """Every start of every effect, and of the plain servo's parameters."""

    names: tuple[str, ...]  # effect or parameter of each, of which there are K
    rows: Array  # the servo with it, shape (K, P)
    signed: Mask  # whether it means something backwards, too, shape (K,)
    moved: tuple[Array, ...]  # how it moves the angles of each recording, (K, T) each


def directions(of: Explained) -> Directions:
    """Simulate them all."""
    kp, inertia = float(of.row[0]), of.traces[0].load.inertia_kgm2
    present = {COLUMNS[k].partition(".")[0] for k in np.flatnonzero(of.row) if "." in COLUMNS[k]}
    rows, names = [of.row], []
    if of.way != "rest":
        for k, name in enumerate(GAINS):
            rows.append(of.row.copy())
            rows[-1][k] += 0.01 if name == "latency_s" else 0.1 * of.row[k]
            names.append(name)
    for option in candidates(present - {"motor"}, kp, inertia):
        for start in option.starts if not option.effect.everywhere else ():
            rows.append(of.row.copy())
            rows[-1][option.columns] = start
            names.append(option.effect.name)
    table = np.array(rows)
    angles = of.simulated(table, range(len(of.traces)))
    moved = tuple(np.nan_to_num(a[1:] - a[:1]) for a in angles)
    signed = np.array([n in GAINS or named(n).either_sign for n in names])
    return Directions(tuple(names), table[1:], signed, moved)


def first_look(of: Explained, by: Directions, own: Sequence[int]) -> tuple[Array, Array, Array]:
    """Free each direction in the recordings ``own`` only, what the law shares in all.

    Least squares, linear in all parameters, one variance for all recordings. Where it is free in
    references, the case is left out: what changed there is nothing that references leave.

    Returns:
        What it takes away from them, as a mean square in rad2, its size in multiples of the start,
        and the mean square that is left of them, each of shape (K,).
    """
    K, F = len(by.names), of.precision.shape[0]
    normal, slope = of.variance * of.precision, np.zeros(F)
    cross, along, square = np.zeros((F, K)), np.zeros(K), np.zeros(K)
    for r in {*range(of.references), *own}:
        seen = of.seen(r)
        J, e = of.shared[r][seen], of.residuals[r][seen]
        normal = normal + J.T @ J
        slope = slope + J.T @ e
        if r in own:
            D = by.moved[r][:, seen]
            cross += J.T @ D.T
            along += D @ e
            square += (D**2).sum(axis=1)
    count = of.count(own)
    if not count:
        return np.zeros(K), np.zeros(K), np.zeros(K)
    inverse = np.linalg.pinv(normal, rcond=1e-12, hermitian=True) if F else normal
    along = along - cross.T @ (inverse @ slope)
    free = square - np.einsum("fk,fg,gk->k", cross, inverse, cross)
    visible = free > 1e-6 * square + 1e-30
    size = np.where(visible, along / np.where(visible, free, 1.0), 0.0)
    size[(size < 0) & ~by.signed] = 0.0
    law = inverse @ (slope[:, None] - cross * size)
    remaining = np.zeros(K)
    for r in own:
        seen = of.seen(r)
        error = of.residuals[r][seen][:, None] - of.shared[r][seen] @ law
        remaining += ((error - by.moved[r][:, seen].T * size) ** 2).sum(axis=0)
    return np.where(visible, size * along, 0.0) / count, size, remaining / count


@dataclass(frozen=True)
class Contrast:
    """What a change of each effect would explain of a joint's case."""

    effects: tuple[str, ...]  # the effects, and parameters of the plain servo, of which there are N
    gone: Array  # mean square that each takes away from the case, rad2, shape (N,)
    remaining: Array  # mean square that each leaves, shape (N,)
    size: Array  # how far each lies, in multiples of its start, shape (N,)
    rows: Array  # the case's servo with each, shape (N, P)
    usual: Array  # what each takes away where nothing has changed, in ``unit``, by the bank, (N,)
    in_references: Array  # the sum of what each takes away from the references, rad2, shape (N,)
    known: tuple[float, float]  # unchanged recordings behind the null sizes, of the bank and in all
    scale2: float  # mean square residual of the references
    law: bool = False  # whether these are explained by a law, which may fit few of them too well

    @property
    def null(self) -> Array:
        """Mean square that each takes away where nothing has changed, rad2, shape (N,)."""
        bank, every = self.known
        of_bank = self.usual * unit(self.law, self.scale2, self.remaining) * bank
        return np.asarray((of_bank + self.in_references) / every)

    @property
    def evidence(self) -> Array:
        """Log odds of each change, of unknown size, against none, without the prior, (N,)."""
        return student(self.gone / self.null, self.known[1])

    @property
    def behind(self) -> Array:
        """What each explains less than the best does, in nats, shape (N,).

        A law is not quite what a servo does: it may be wrong by a share of what it explains.
        """
        best = int(np.argmax(self.gone))
        blurred = self.null[best] + DECISION.change.law_error**2 * self.gone[best]
        return np.asarray(0.5 * (self.gone[best] - self.gone) / blurred)


def contrast(of: Explained, by: Directions) -> Contrast:
    """Weigh a change of each effect against none, to first order."""
    unchanged = BANKS[of.way]
    names = tuple(dict.fromkeys(by.names))
    place = [np.flatnonzero([n == name for n in by.names]) for name in names]
    gone, size, remaining = first_look(of, by, of.case)
    # Of several starts that which needs no far extrapolation.
    near = gone / np.maximum(np.abs(size) / straight(of), 1.0) ** 2
    best = np.array([mine[np.argmax(near[mine])] for mine in place])
    seen = [r for r in range(of.references) if of.seen(r).any()]
    middle = float(np.median(list(unchanged.null.values())))
    usual = np.array([unchanged.null.get(name, middle) for name in names])
    if of.way == "repeat":
        usual *= np.mean([at_any_time(of.residuals[r], by.moved[r][best]) for r in seen], axis=0)
    looks = [first_look(of, by, [r])[0] for r in seen]
    return Contrast(
        effects=names,
        gone=gone[best],
        remaining=remaining[best],
        size=size[best],
        rows=of.row + (by.rows[best] - of.row) * np.clip(size[best], -1, 1)[:, None],
        usual=usual,
        in_references=np.array([sum(float(x[mine].max()) for x in looks) for mine in place]),
        known=(unchanged.known, unchanged.known + len(seen)),
        scale2=of.scale2,
        law=of.way == "law",
    )


def straight(of: Explained) -> float:
    """Multiples of its initial value that a change reaches along a straight line."""
    return DECISION.change.max_extrapolation if of.way == "law" else 1.0


def unit(law: bool, scale2: float, remaining: Array) -> Array:
    """What null sizes are multiples of, rad2, shape (N,): what is left, at least ``scale2``.

    That of references alone where no law explains the recordings. ``remaining`` is the mean square
    that effects leave of the case, shape (N,).
    """
    return np.maximum(remaining, scale2) if law else np.full(remaining.shape, scale2)


def at_any_time(residual: Array, moved: Array) -> Array:
    """Share of a reference's residual (T,) that directions (N, T) take away at a random time, (N,).

    The mean over all times, by the theorem of Wiener and Khinchin. NaN are not looked at.
    """
    seen = np.isfinite(residual)
    shown = np.where(seen, residual, 0.0), np.where(seen, moved, 0.0)
    power, other = (np.abs(np.fft.fft(x)) ** 2 for x in shown)
    weight = power.sum() * other.sum(axis=1)
    share = np.ones(len(moved))
    np.divide(other @ power, weight, out=share, where=weight > 0)
    return share


def first_pairs(of: Explained, by: Directions) -> dict[frozenset[str], tuple[Array, float]]:
    """Each pair of effects as the case is explained best, to first order, the best pair first.

    By least squares; no law shares anything.

    Returns:
        For each pair the servo with it, shape (P,), and the mean square that it leaves, rad2;
        infinite where one lies farther than its start, as no straight line leads there.
    """
    seen = np.concatenate([of.seen(r) for r in of.case])
    e = np.concatenate([of.residuals[r] for r in of.case])[seen]
    D = np.concatenate([by.moved[r] for r in of.case], axis=1)[:, seen]
    gram, along = D @ D.T, D @ e
    square = np.diag(gram)
    free = square[:, None] * square - gram**2
    visible = free > 1e-6 * square[:, None] * square
    size = along[:, None] * square - along * gram  # of the first of two, times ``free``
    size = np.divide(size, free, out=np.zeros_like(size), where=visible)
    gone = size * along[:, None]
    gone = gone + gone.T
    wrong = (size < 0) & ~by.signed[:, None]
    plain = np.isin(by.names, GAINS)
    gone[wrong | wrong.T | ~visible | plain[:, None] | plain] = 0.0
    far = np.abs(size) > 1
    remaining = np.where(far | far.T, np.inf, np.maximum(e @ e - gone, 0.0) / max(e.size, 1))
    pairs: dict[frozenset[str], tuple[Array, float]] = {}
    for i, j in zip(*np.unravel_index(np.argsort(-gone, axis=None), gone.shape), strict=True):
        pair = frozenset((by.names[i], by.names[j]))
        if gone[i, j] > 0 and len(pair) == 2 and pair not in pairs:
            more = size[i, j] * (by.rows[i] - of.row) + size[j, i] * (by.rows[j] - of.row)
            pairs[pair] = of.row + more, float(remaining[i, j])
    return pairs


def fitted(
    of: Explained, effects: Sequence[str], starts: Sequence[Array], *, evaluations: int = 40
) -> tuple[Array, float]:
    """Fit effects, or parameters of the plain servo, to the case; the servo itself stays.

    ``starts`` are servos to start from, shape (P,) each.

    Returns:
        The servo with these effects, shape (P,), and the mean square that it leaves, rad2.
    """
    bounds = zip(*(_bounds(of, name) for name in effects), strict=True)
    columns, low, high, scale = (np.concatenate(x) for x in bounds)
    columns = columns.astype(int)
    low, high = low / scale, high / scale
    base = of.simulated(of.row[None], of.case)
    noise = np.sqrt(of.scale2)

    def residuals(x: Array) -> Array:
        rows = np.tile(of.row, (len(x), 1))
        rows[:, columns] = x * scale
        moved = [a - b for a, b in zip(of.simulated(rows, of.case), base, strict=True)]
        parts = [(of.residuals[r] - m)[:, of.seen(r)] for r, m in zip(of.case, moved, strict=True)]
        return np.nan_to_num(np.concatenate(parts, axis=1), nan=1e3)

    def about(x: Array) -> Expansion:
        step = np.where(x + DIFFERENCE > high, -DIFFERENCE, DIFFERENCE)
        error, *others = residuals(np.vstack([x, x + np.diag(step)])) / noise
        return expansion(error, ((np.array(others) - error) / step[:, None]).T)

    minimum = minimise(
        lambda points, _: stacked([about(x) for x in points]),
        np.array([start[columns] / scale for start in starts]),
        *(np.tile(ends, (len(starts), 1)) for ends in (low, high)),
        evaluations=evaluations,
        settled=1e-3,
    )
    k = int(np.argmin(minimum.expansion.loss))
    best = of.row.copy()
    best[columns] = minimum.x[k] * scale
    return best, 2 * float(minimum.expansion.loss[k]) * of.scale2 / max(of.count(of.case), 1)


def _bounds(of: Explained, name: str) -> tuple[Array, Array, Array, Array]:
    """Columns of an effect's parameters, their bounds, and their natural sizes, shape (K,) each."""
    if name not in GAINS:
        option = candidate(named(name), float(of.row[0]), of.traces[0].load.inertia_kgm2)
        return option.columns.astype(float), option.low, option.high, option.unit
    column = GAINS.index(name)
    value = max(float(of.row[column]), 1e-6)
    high, size = (0.5, 0.02) if name == "latency_s" else (30 * value, value)
    return np.array([column]), np.zeros(1), np.array([high]), np.array([size])
