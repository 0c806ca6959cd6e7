"""What a case gives back: our figures beside the published ones, and curves to look at."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Figure:
    """One number beside its reference.

    Attributes:
        quantity: What it is, with its unit.
        ours: Our value.
        reference: The published value.
        bar: Largest error that passes; None where it is only reported.
        scale: What the error is relative to; the reference itself where None.
    """

    quantity: str
    ours: float
    reference: float
    bar: float | None = None
    scale: float | None = None

    @property
    def error(self) -> float:
        """Absolute difference relative to the scale."""
        return abs(self.ours - self.reference) / abs(self.scale or self.reference)

    @property
    def met(self) -> bool:
        """Whether the error is within the bar; NaN is not."""
        return self.bar is None or self.error <= self.bar


@dataclass(frozen=True)
class Curve:
    """A line of ours and, where there is one, the published one; labels have their units."""

    title: str
    x_label: str
    y_label: str
    x: Array
    y: Array
    reference_x: Array = field(default_factory=lambda: np.zeros(0))
    reference_y: Array = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True)
class Case:
    """A case that was run.

    Attributes:
        name: Its module's name.
        title: What flows round what.
        source: Where the reference is from.
        setup: Resolution, steps, boundary conditions, in one line.
        figures: Our numbers beside the published ones.
        curves: Lines to look at.
    """

    name: str
    title: str
    source: str
    setup: str
    figures: tuple[Figure, ...]
    curves: tuple[Curve, ...] = ()
