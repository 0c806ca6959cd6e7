"""Distribution of mass along a robot: the normalised density of each link."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from sim2real.arrays import Array
from sim2real.display import NotebookDisplay, from_report
from sim2real.inference.normal import Z90
from sim2real.model import Model
from sim2real.robot import Robot

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Density(NotebookDisplay):
    """Normalised density of L links, 1 where mass per length equals that of the robot.

    Attributes:
        links: Names of the links.
        value: Normalised densities, shape (L,).
        sd: Their standard deviations, shape (L,); None if no link states one.
        mass_kg, length_m: Measured masses and lengths, shape (L,).
    """

    links: tuple[str, ...]
    value: Array
    sd: Array | None
    mass_kg: Array
    length_m: Array

    @property
    def interval(self) -> Array | None:
        """Lower and upper ends of 90 % intervals, shape (2, L); None where ``sd`` is."""
        return None if self.sd is None else self.value + Z90 * np.outer([-1, 1], self.sd)

    def __str__(self) -> str:
        """Mass, length and normalised density of each link."""
        width = max(len("link"), *(len(name) for name in self.links))
        lines = [f"{'link':<{width}}  mass, kg  length, m  density   90 % interval"]
        for k, name in enumerate(self.links):
            line = f"{name:<{width}}  {self.mass_kg[k]:8.3f}  {self.length_m[k]:9.3f}"
            line += f"  {self.value[k]:7.3f}"
            if self.interval is not None:
                low, high = self.interval[:, k]
                line += f"   {low:.3f} to {high:.3f}"
            lines.append(line)
        if self.interval is None:
            lines.append("  ! mass_sd_kg and length_sd_m of the links would give intervals")
        return "\n".join(lines)

    def plot(self) -> Figure:
        """Bar chart of the normalised density of each link."""
        figure: Figure = from_report("range_plots.density_figure")(self)
        return figure


def normalised_density(robot: Robot) -> Density:
    """Mass per length of each link over that of the robot: rho_i = (m_i / l_i) sum(l) / sum(m).

    Source: Lin, Liu, Wang (2024), Sec. III-B.1. Errors of masses and lengths are assumed to be
    independent and small, and are propagated linearly through the logarithm:

        d log rho_i = dm_i / m_i - dl_i / l_i + sum(dl) / sum(l) - sum(dm) / sum(m).
    """
    mass, length = (np.array([getattr(x, n) for x in robot.links]) for n in ("mass_kg", "length_m"))
    value = mass / length * length.sum() / mass.sum()
    stated = [s for x in robot.links for s in (x.mass_sd_kg, x.length_sd_m) if s is not None]
    sd = None
    if stated:
        mass_sd = np.array([x.mass_sd_kg or 0.0 for x in robot.links])
        length_sd = np.array([x.length_sd_m or 0.0 for x in robot.links])
        by_mass = np.diag(1 / mass) - 1 / mass.sum()
        by_length = 1 / length.sum() - np.diag(1 / length)
        sd = value * np.hypot(
            np.linalg.norm(by_mass * mass_sd, axis=1), np.linalg.norm(by_length * length_sd, axis=1)
        )
    return Density(tuple(x.name for x in robot.links), value, sd, mass, length)


def with_density(model: Model, density: Density) -> Model:
    """Model with ``body.normalised_density``, and ``normalised_density_sd`` if known."""
    body = dict(model.body) | {"normalised_density": [float(x) for x in density.value]}
    body.pop("normalised_density_sd", None)
    if density.sd is not None:
        body["normalised_density_sd"] = [float(x) for x in density.sd]
    return replace(model, body=body)
