"""What cases share: their result, the device, bodies, a gradual start, and readings of signals."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim.fluid.fluid import Fluid
from sim.lattice.velocities import Lattice, Units
from sim.robot.bodies import HELD, Bodies, Masses
from sim.robot.shape import Hull, displaced
from sim2real.arrays import Array

LATTICE = Units(1.0, 1.0, 1.0, 1.0)


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

    @property
    def cells(self) -> tuple[str, ...]:
        """What is told of it."""
        bar = "" if self.bar is None else f"{100 * self.bar:g} %"
        verdict = "" if self.bar is None else "met" if self.met else "MISSED"
        numbers = f"{self.ours:.5g}", f"{self.reference:.5g}", f"{100 * self.error:.2f} %"
        return (self.quantity, *numbers, bar, verdict)


@dataclass(frozen=True)
class Case:
    """Result of a case.

    Attributes:
        title: Title.
        source: Source of the reference.
        setup: Resolution, steps, boundary conditions, in one line.
        figures: Computed and published numbers.
    """

    title: str
    source: str
    setup: str
    figures: list[Figure]


@dataclass(frozen=True)
class Where:
    """Where a case runs; ``quick`` is a coarse version with wider bars, in seconds."""

    device: str = "cpu"
    threads: int = 2
    quick: bool = False

    @property
    def gpu(self) -> bool:
        """Whether finer cells are affordable."""
        return self.device.startswith("cuda")

    def fluid(self, lattice: Lattice, size: Iterable[int], **more: Any) -> Fluid:  # noqa: ANN401
        """Boxes of fluid on the device."""
        return Fluid(lattice, tuple(size), device=self.device, threads=self.threads, **more)


CPU = Where()


def ball(radius: float) -> Hull:
    """A disc or ball."""
    return Hull(np.zeros(1), np.full((1, 3), radius), np.full((1, 3), radius))


def chain(length: Array, radii: Array) -> Hull:
    """Round links with these radii at nose, joints and tip."""
    half = np.stack([radii[:-1], (radii[:-1] + radii[1:]) / 2, radii[1:]], axis=1)
    return Hull(length, half, half)


def neutral(hull: Hull, cell: float, units: Units, *, flat: bool) -> Masses:
    """Masses of links as heavy as the water that they displace."""
    water = displaced(hull, cell, 0.0, flat)
    unit = units.density_kg_m3 * (units.depth_m if flat else 1.0)
    return Masses(unit * water[:, 0], unit * water[:, 2], water[:, 1])


def prescribed(
    fluid: Fluid,
    hull: Hull,
    start: Array,
    units: Units = LATTICE,
    **more: Any,  # noqa: ANN401
) -> Bodies:
    """Bodies whose motion is prescribed, so that their masses do not matter, at a place."""
    links = hull.length.size
    light = Masses(np.ones(links), np.ones(links), np.zeros(links))
    bodies = Bodies(fluid, hull, light, units, **more)
    bodies.place(start)
    return bodies


def forces(bodies: Bodies, rates: Iterable[Array]) -> Array:
    """Forces and moments on all links of each body at each prescribed velocity, (steps, E, 3).

    They are NaN where the flow broke down.
    """
    found = []
    for rate in rates:
        bodies.prescribe(rate)
        bodies.step(HELD)
        found.append(bodies.motion.force.numpy().sum(axis=1))
    out = np.array(found)
    out[:, bodies.fluid.stopped.numpy() >= 0] = np.nan
    return out


def amplitude(values: Array, period: int) -> Array:
    """Amplitudes of signals (T, ...) at a period of so many samples, beside a straight line."""
    t = 2 * np.pi / period * np.arange(len(values))
    basis = np.stack([np.cos(t), np.sin(t), np.ones_like(t), t], axis=1)
    fit = np.linalg.lstsq(basis, values, rcond=None)[0]
    return np.asarray(np.hypot(fit[0], fit[1]))
