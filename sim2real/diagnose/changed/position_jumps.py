"""Where recordings jump as no reference does."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sim2real.diagnose.changed.regression import Explained
from sim2real.diagnose.decision import DECISION
from sim2real.inference.segments import Window

Array = NDArray[np.float64]


class Steps:
    """Steps of what is left from one sample to the next.

    What acts on a shaft moves it smoothly. What is left of a recording jumps where its sensor, its
    clock or its horn does something of its own.

    Args:
        of: The recordings, explained.
        step_rad: Step of the case's sensor, which is no jump.
    """

    def __init__(self, of: Explained, step_rad: float = 0.0) -> None:
        self.of = of
        self.each = [_steps(of.traces[r].t, left) for r, left in enumerate(of.left)]
        largest = [float(size.max(initial=0.0)) for _, size in self.each]
        self.usual = max([*largest[: of.references], step_rad])
        self.largest = max(largest[of.references :])

    def ratio(self) -> float:
        """The case's largest over the references'."""
        return self.largest / self.usual if self.usual > 0 else 0.0

    def windows(self, ratio: float) -> tuple[tuple[Window, ...], ...] | None:
        """From the first to the last step that is so many times the references', or to the end.

        To the end where there is but one, or where what is left stays far larger than before.

        Returns:
            Windows of each recording of the case; None where there are none.
        """
        found: list[tuple[Window, ...]] = []
        for r in self.of.case:
            at, size = self.each[r]
            when = at[size > ratio * self.usual] if self.usual > 0 else at[:0]
            last = float(self.of.traces[r].t[-1])
            stays = when.size < 2 or self._stays(r, float(when[0]), float(when[-1]))
            found.append(
                ((float(when[0]), last if stays else float(when[-1])),) if when.size else ()
            )
        return tuple(found) if any(found) else None

    def _stays(self, r: int, first: float, last: float) -> bool:
        """Whether a recording is far off after the last jump, and was not before the first."""
        t, left2 = self.of.traces[r].t, self.of.left[r] ** 2
        seen = np.isfinite(left2)
        before, after = left2[seen & (t < first)], left2[seen & (t > last)]
        if before.size == 0 or after.size == 0:
            return False
        usual = max(float(np.mean(before)), self.of.scale2)
        return float(np.mean(after)) > DECISION.change.lasting_ratio**2 * usual


def _steps(t: Array, left: Array) -> tuple[Array, Array]:
    """Times and sizes of steps between samples that follow each other."""
    apart, size = np.diff(t), np.abs(np.diff(left))
    good = (apart < 1.5 * float(np.median(apart))) & np.isfinite(size)
    return t[1:][good], size[good]
