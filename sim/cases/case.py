"""Result of a case: computed and published figures, and curves."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sim2real.arrays import Array


@dataclass(frozen=True)
class Figure:
    """One computed number and its reference.

    Attributes:
        quantity: Name with unit.
        ours: Computed value.
        reference: The published value.
        bar: Largest error that passes; None for figures without a bar.
        scale: Value that the error is relative to; the reference where None.
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
    """A computed curve and, if there is one, the published curve; labels have their units."""

    title: str
    x_label: str
    y_label: str
    x: Array
    y: Array
    reference_x: Array = field(default_factory=lambda: np.zeros(0))
    reference_y: Array = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True)
class Case:
    """Result of a case.

    Attributes:
        name: Its module's name.
        title: Title.
        source: Source of the reference.
        setup: Resolution, steps, boundary conditions, in one line.
        figures: Computed and published numbers.
        curves: Curves to plot.
    """

    name: str
    title: str
    source: str
    setup: str
    figures: tuple[Figure, ...]
    curves: tuple[Curve, ...] = ()
