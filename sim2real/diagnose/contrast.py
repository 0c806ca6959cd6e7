"""How much more of a case a change explains than where nothing has changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sim2real.arrays import Array, Index, Mask
from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.explained import GAINS, Explained, simulated
from sim2real.diagnose.screening import candidates
from sim2real.effects import named
from sim2real.identification.priors import gains, of_effects
from sim2real.identification.problem import ServoProblem
from sim2real.identification.search import search
from sim2real.inference.evidence import student
from sim2real.servo.parameters import COLUMNS
from sim2real.servo.trace import Trace
from sim2real.structured import read_json

BANK = Path(__file__).with_name("unchanged.json")
BANKS = read_json(BANK, "sim2real.unchanged/1")["ways"]
"""What recordings look like in which nothing has changed, by the way they are explained, as
``benchmarks/unchanged_bank.py`` found them: ``known``, how many there are; ``null``, for each
effect the mean square that it takes away, over the references' residual; ``jump``, the largest step
of the residual, over the references', that is no sign of anything."""


@dataclass(frozen=True)
class Directions:
    """Every start of every effect, and of the plain servo's parameters."""

    names: tuple[str, ...]  # effect or parameter of each, of which there are K
    rows: Array  # the servo with it, shape (K, P)
    signed: Mask  # whether it means something backwards, too, shape (K,)
    moved: Array  # how it moves the angles of all recordings, shape (K, n)


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
    angles = simulated(of.traces, np.array(rows), of.row)
    signed = np.array([n in GAINS or named(n).either_sign for n in names])
    moved = np.nan_to_num(angles[1:] - angles[:1])
    return Directions(tuple(names), np.array(rows[1:]), signed, moved)


def first_look(of: Explained, by: Directions, own: Mask) -> tuple[Array, Array, Array]:
    """Free each direction at the samples ``own`` (n,) only, what the law shares in all.

    Least squares, linear in all parameters, one variance for all recordings. Where it is free in
    references, the case is left out: what changed there is nothing that references leave.

    Returns:
        What it takes away from them, as a mean square in rad2, its size in multiples of the start,
        and the mean square that is left of them, each of shape (K,).
    """
    every = own | ~of.case
    J, e = of.shared[every], of.residual[every]
    inverse = np.linalg.pinv(of.variance * of.precision + J.T @ J, rcond=1e-12, hermitian=True)
    slope = J.T @ e
    D, J, e = by.moved[:, own], of.shared[own], of.residual[own]
    if not e.size:
        none = np.zeros(len(by.names))
        return none, none, none
    cross, square = J.T @ D.T, (D**2).sum(axis=1)
    along = D @ e - cross.T @ (inverse @ slope)
    free = square - np.einsum("fk,fg,gk->k", cross, inverse, cross)
    visible = free > 1e-6 * square + 1e-30
    size = np.where(visible, along / np.where(visible, free, 1.0), 0.0)
    size[(size < 0) & ~by.signed] = 0.0
    law = inverse @ (slope[:, None] - cross * size)
    remaining = ((e[:, None] - J @ law - D.T * size) ** 2).mean(axis=0)
    return np.where(visible, size * along, 0.0) / e.size, size, remaining


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

    def __getitem__(self, order: Index) -> Contrast:
        """Some of the changes."""
        arrays = {k: x for k, x in vars(self).items() if isinstance(x, np.ndarray)}
        parts: dict[str, Any] = {k: x[order] for k, x in arrays.items()}
        return replace(self, effects=tuple(self.effects[k] for k in order), **parts)

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
    bank = BANKS[of.way]
    names = tuple(dict.fromkeys(by.names))
    place = [np.flatnonzero([n == name for n in by.names]) for name in names]
    gone, size, remaining = first_look(of, by, of.case)
    # Of several starts that which needs no far extrapolation.
    near = gone / np.maximum(np.abs(size) / straight(of), 1.0) ** 2
    best = np.array([mine[np.argmax(near[mine])] for mine in place])
    seen = [mine for r in range(of.references) if (mine := of.recording == r).any()]
    middle = float(np.median(list(bank["null"].values())))
    usual = np.array([bank["null"].get(name, middle) for name in names])
    if of.way == "repeat":
        shares = [at_any_time(of.residual[mine], by.moved[best][:, mine]) for mine in seen]
        usual *= np.mean(shares, axis=0)
    looks = [first_look(of, by, mine)[0] for mine in seen]
    return Contrast(
        effects=names,
        gone=gone[best],
        remaining=remaining[best],
        size=size[best],
        rows=of.row + (by.rows[best] - of.row) * np.clip(size[best], -1, 1)[:, None],
        usual=usual,
        in_references=np.array([sum(float(x[mine].max()) for x in looks) for mine in place]),
        known=(bank["known"], bank["known"] + len(seen)),
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

    The mean over all times, by the theorem of Wiener and Khinchin.
    """
    power, other = (np.abs(np.fft.fft(x)) ** 2 for x in (residual, moved))
    weight = power.sum() * other.sum(axis=1)
    share = np.ones(len(moved))
    np.divide(other @ power, weight, out=share, where=weight > 0)
    return share


def first_pairs(of: Explained, by: Directions) -> dict[frozenset[str], Array]:
    """The servo (P,) with each pair of effects that explains the case, to first order, best first.

    By least squares; no law shares anything.
    """
    e, D = of.residual[of.case], by.moved[:, of.case]
    gram, along = D @ D.T, D @ e
    square = np.diag(gram)
    both = np.outer(square, square)
    free = both - gram**2
    size = along[:, None] * square - along * gram  # of the first of two, times ``free``
    size = np.divide(size, free, out=np.zeros_like(size), where=free > 1e-6 * both)
    gone = size * along[:, None]
    gone += gone.T
    never = (size < 0) & ~by.signed[:, None] | np.isin(by.names, GAINS)
    gone[never | never.T] = 0.0
    pairs: dict[frozenset[str], Array] = {}
    for i, j in zip(*np.unravel_index(np.argsort(-gone, axis=None), gone.shape), strict=True):
        pair = frozenset((by.names[i], by.names[j]))
        if gone[i, j] > 0 and len(pair) == 2 and pair not in pairs:
            more = size[i, j] * (by.rows[i] - of.row) + size[j, i] * (by.rows[j] - of.row)
            pairs[pair] = of.row + more
    return pairs


def fitted(of: Explained, effects: Sequence[str], starts: Sequence[Array]) -> tuple[Array, float]:
    """Fit effects, or parameters of the plain servo, to the case; the servo itself stays.

    ``starts`` are servos to start from, shape (P,) each.

    Returns:
        The servo with these effects, shape (P,), and the mean square that it leaves, rad2.
    """
    inertia = of.traces[0].load.inertia_kgm2
    free = [p for p in gains(inertia) if p.name in effects]
    free += of_effects([named(name) for name in effects if name not in GAINS], of.row, inertia)
    case, residual = of.traces[of.references :], of.residual[of.case]
    problem = ServoProblem(case, of.row, tuple(free))
    parts = problem.by_trace(problem.row_residuals(of.row[None])[0] + residual)
    case = tuple(_beyond(*pair) for pair in zip(case, parts, strict=True))
    problem = replace(problem, traces=case)
    noise = max(float(np.sqrt(of.energy)), 1e-9), 1.0
    x, _, _, _ = search(problem, problem.searched(np.array(starts)), noise, 40)
    left = problem.residuals(x[:1])
    return problem.rows(x[:1])[0], float(np.mean(left**2))


def _beyond(trace: Trace, more: Array) -> Trace:
    """A trace whose used angles are larger by ``more`` (n,)."""
    position = trace.position.copy()
    position[trace.used] += more
    return replace(trace, position=position)
