"""Decaying vortices in a periodic box: order of convergence, and effective viscosity.

Source of the solution: Taylor and Green, Proc. R. Soc. Lond. A 158 (1937) 499, in two dimensions
an exact solution of the Navier-Stokes equations.
"""

from __future__ import annotations

import numpy as np

from sim.cases.case import Case, Curve, Figure
from sim.fluid.fluid import CS2, Fluid
from sim.lattice.velocities import D2Q9, D3Q19, Lattice
from sim2real.arrays import Array

_PLANES = {"xy": (0, 1), "yz": (1, 2), "zx": (2, 0)}
_VISCOSITY = 0.1
_SPEED, _COARSEST = 0.04, 16
"""Largest speed in cells per step in the coarsest box; proportional to the size of the cells, so
that the compressibility error falls with its square too."""
_LOOKS = 40


def vortices(size: int, t: float, plane: tuple[int, int]) -> tuple[Array, Array, Array]:
    """Density, velocity and strain rate at t steps, one vortex pair each way: axes as in ``Fluid``.

    Args:
        size: Cells per side.
        t: Steps since the start.
        plane: The two axes of the velocity; the flow is uniform along the third.
    """
    first, second = plane
    k = 2 * np.pi / size
    shape = [1, 1, 1, 1]
    shape[1 + first] = shape[1 + second] = size
    grid = np.indices(shape)
    x, y = k * grid[1 + first], k * grid[1 + second]
    U = _SPEED * _COARSEST / size * np.exp(-2 * _VISCOSITY * k * k * t)
    u, strain = np.zeros((*shape, 3)), np.zeros((*shape, 6))
    u[..., first], u[..., second] = U * np.sin(x) * np.cos(y), -U * np.cos(x) * np.sin(y)
    strain[..., first] = k * U * np.cos(x) * np.cos(y)
    strain[..., second] = -strain[..., first]  # the shear strain of this flow is zero
    density = 1 + U * U / 4 / CS2 * (np.cos(2 * x) + np.cos(2 * y))
    return density, u, strain


def decay(
    lattice: Lattice, size: int, plane: str, *, device: str = "cpu", threads: int = 2
) -> tuple[float, float]:
    """Relative error of the velocity until half of it is left, and viscosity over the nominal one.

    The error is the root of the mean square over all cells and over times spread evenly: the start
    sets off faint sound, which at one moment may be near its zero. The viscosity is that of the
    energy's decay.
    """
    axes = _PLANES[plane]
    density, start, strain = vortices(size, 0.0, axes)
    fluid = Fluid(lattice, start.shape[1:4], viscosity=_VISCOSITY, device=device, threads=threads)
    fluid.set(density, start, strain)
    rate = 2 * _VISCOSITY * (2 * np.pi / size) ** 2
    times = np.unique(np.linspace(0, np.log(2) / rate, _LOOKS + 1).round().astype(int))
    ours, squares, steps = start, 0.0, np.diff(times)
    for t, count in zip(times[1:], steps, strict=True):
        fluid.step(int(count))
        ours, exact = fluid.moments()[1].astype(np.float64), vortices(size, float(t), axes)[1]
        squares += float(np.sum((ours - exact) ** 2) / np.sum(exact**2))
    found = np.log(np.sum(start**2) / np.sum(ours**2)) / 2 / times[-1]
    return float(np.sqrt(squares / steps.size)), float(found / rate)


def run(*, device: str = "cpu", threads: int = 2, quick: bool = False) -> Case:
    """Both lattices, and all planes of the second, at three or four resolutions."""
    sizes = np.array([16, 32] if quick else [16, 32, 64, 128])
    figures, curves = [], []
    for lattice, plane in ((D2Q9, "xy"), (D3Q19, "xy"), (D3Q19, "yz"), (D3Q19, "zx")):
        found = np.array(
            [decay(lattice, int(n), plane, device=device, threads=threads) for n in sizes]
        )
        order = -np.polyfit(np.log(sizes), np.log(found[:, 0]), 1)[0]
        where = f"{lattice.name}, {plane}"
        figures += [
            Figure(f"order of convergence ({where})", float(order), 2.0, 0.05),
            Figure(f"viscosity over nominal, {sizes[1]} cells ({where})", found[1, 1], 1.0, 0.01),
        ]
        second = found[0, 0] * (sizes[0] / sizes) ** 2.0
        curves.append(
            Curve(
                f"Error of the velocity ({where}); reference: second order",
                "cells a side", "relative error", sizes.astype(np.float64), found[:, 0],
                sizes.astype(np.float64), second,
            )
        )  # fmt: skip
    return Case(
        name="taylor_green",
        title="Taylor-Green vortices decay in a periodic box",
        source="exact: Taylor and Green, Proc. R. Soc. Lond. A 158 (1937) 499",
        setup=f"{sizes[0]} to {sizes[-1]} cells a side, viscosity {_VISCOSITY:g}, "
        f"speed {_SPEED:g} at {_COARSEST} cells falling as the cells, until half is left",
        figures=tuple(figures),
        curves=tuple(curves),
    )
