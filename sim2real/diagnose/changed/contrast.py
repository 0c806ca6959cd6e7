"""How much more of a case a change explains than where nothing has changed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim2real.diagnose.changed.regression import Directions, Explained, first_look
from sim2real.diagnose.changed.repeated_commands import at_any_time, unit
from sim2real.inference.evidence import student

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Unchanged:
    """What recordings look like in which nothing has changed, by the way they are explained.

    Attributes:
        known: How many of them there are.
        null: Null size of each effect, mean squares over what references leave.
        jump: Largest step of what is left, over the references', that is no sign of anything.
    """

    known: float
    null: Mapping[str, float]
    jump: float


@dataclass(frozen=True)
class Contrast:
    """What a change of each effect would explain of a joint's case.

    Attributes:
        effects: The effects, and parameters of the plain servo, of which there are N.
        gone: Mean square that each takes away from the case, rad2, shape (N,).
        left: Mean square that each leaves, shape (N,).
        size: How far each lies, in multiples of its start, shape (N,).
        rows: The case's servo with each, shape (N, P).
        usual: What each takes away where nothing has changed, in ``unit``, by the bank, (N,).
        before: The sum of what each takes away from the references, rad2, shape (N,).
        known: Unchanged recordings behind the null sizes, of the bank and in all.
        scale2: Mean square that is left of the references.
        law_error: Share of what it explains by which a law may be wrong.
        law: Whether these are explained by a law, which may fit few of them too well.
    """

    effects: tuple[str, ...]
    gone: Array
    left: Array
    size: Array
    rows: Array
    usual: Array
    before: Array
    known: tuple[float, float]
    scale2: float
    law_error: float
    law: bool = False

    @property
    def null(self) -> Array:
        """Mean square that each takes away where nothing has changed, rad2, shape (N,)."""
        bank, every = self.known
        return (self.usual * unit(self.law, self.scale2, self.left) * bank + self.before) / every

    @property
    def evidence(self) -> Array:
        """Log odds of each change, of unknown size, against none, without the prior, (N,)."""
        return student(self.gone / self.null, self.known[1])

    @property
    def misfit(self) -> Array:
        """What each explains less than the best does, in nats, shape (N,).

        A law is not quite what a servo does: it may be wrong by a share of what it explains.
        """
        best = int(np.argmax(self.gone))
        blurred = self.null[best] + self.law_error**2 * self.gone[best]
        return np.asarray(0.5 * (self.gone[best] - self.gone) / blurred)


def contrast(
    of: Explained, by: Directions, unchanged: Unchanged, straight: float, law_error: float
) -> Contrast:
    """Weigh a change of each effect against none, at first sight.

    Args:
        of: The joint's case and its references.
        by: The changes.
        unchanged: What recordings look like in which nothing has changed.
        straight: How many times as far as its start a change goes along a straight line.
        law_error: Share of what it explains by which a law may be wrong.
    """
    names = tuple(dict.fromkeys(by.names))
    place = [np.flatnonzero([n == name for n in by.names]) for name in names]
    gone, size, left = first_look(of, by, of.case)
    # Of several starts that which needs no far extrapolation.
    near = gone / np.maximum(np.abs(size) / straight, 1.0) ** 2
    best = np.array([mine[np.argmax(near[mine])] for mine in place])
    telling = [r for r in range(of.references) if of.seen(r).any()]
    middle = float(np.median(list(unchanged.null.values())))
    usual = np.array([unchanged.null.get(name, middle) for name in names])
    if of.way == "repeat":
        usual *= np.mean([at_any_time(of.left[r], by.moved[r][best]) for r in telling], axis=0)
    looks = [first_look(of, by, [r])[0] for r in telling]
    before = np.array([sum(float(look[mine].max()) for look in looks) for mine in place])
    rows = of.row + (by.rows[best] - of.row) * np.clip(size[best], -1, 1)[:, None]
    known = unchanged.known, unchanged.known + len(telling)
    return Contrast(
        names, gone[best], left[best], size[best], rows, usual, before, known, of.scale2,
        law_error, of.way == "law",
    )  # fmt: skip
