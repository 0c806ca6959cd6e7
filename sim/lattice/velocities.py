"""Velocity sets, directions in which populations move and their weights; units of the lattice.

Source: Qian, d'Humieres, Lallemand, Europhys. Lett. 17 (1992) 479; Kruger et al., The Lattice
Boltzmann Method (Springer, 2017), tables 3.2 and 3.5.
"""

from dataclasses import dataclass
from itertools import product

Velocity = tuple[int, int, int]


@dataclass(frozen=True)
class Lattice:
    """A velocity set whose directions 2k+1 and 2k+2 are opposite; direction 0 rests."""

    name: str  # name in the literature
    dimensions: int  # 2 or 3
    velocities: tuple[Velocity, ...]  # Q triples of -1, 0, 1
    weights: tuple[float, ...]  # Q weights that sum to 1

    @property
    def Q(self) -> int:  # noqa: D102 - the letter of the field
        return len(self.velocities)

    @property
    def pairs(self) -> int:
        """Number of pairs of opposite directions."""
        return self.Q // 2

    def index(self, velocity: Velocity) -> int:
        """Number of the direction with this velocity."""
        return self.velocities.index(velocity)

    def opposite(self, velocity: Velocity) -> int:
        """Number of the direction against this velocity."""
        x, y, z = velocity
        return self.index((-x, -y, -z))


def _lattice(dimensions: int, weight: dict[int, float]) -> Lattice:
    """The velocity set with one weight for each squared speed."""
    axes = [(0, 1, -1)] * dimensions + [(0,)] * (3 - dimensions)
    triples = [(x, y, z) for z, y, x in product(*reversed(axes))]
    chosen = [c for c in triples if sum(x * x for x in c) in weight]
    half = sorted((c for c in chosen if c > (0, 0, 0)), key=lambda c: (sum(map(abs, c)), c))
    ordered = [(0, 0, 0)]
    for x, y, z in half:
        ordered += [(x, y, z), (-x, -y, -z)]
    weights = tuple(weight[sum(x * x for x in c)] for c in ordered)
    return Lattice(f"D{dimensions}Q{len(ordered)}", dimensions, tuple(ordered), weights)


D2Q9 = _lattice(2, {0: 4 / 9, 1: 1 / 9, 2: 1 / 36})
D3Q19 = _lattice(3, {0: 1 / 3, 1: 1 / 18, 2: 1 / 36})

WATER_KG_M3 = 998.0
"""Density of water at 20 degrees C."""
WATER_M2_S = 1.0e-6
"""Kinematic viscosity of water at 20 degrees C."""


@dataclass(frozen=True)
class Units:
    """Sizes of one cell and one step."""

    cell_m: float  # side of a cell
    step_s: float  # duration of a step
    depth_m: float  # depth that a cell represents in two dimensions; its side in three
    density_kg_m3: float = WATER_KG_M3  # density of the fluid

    @property
    def speed_m_s(self) -> float:
        """Speed of one cell per step."""
        return self.cell_m / self.step_s

    @property
    def mass_kg(self) -> float:
        """Mass of one cell of fluid."""
        return self.density_kg_m3 * self.cell_m**2 * self.depth_m

    def viscosity_lu(self, viscosity_m2_s: float) -> float:
        """Kinematic viscosity in cells squared per step."""
        return viscosity_m2_s * self.step_s / self.cell_m**2
