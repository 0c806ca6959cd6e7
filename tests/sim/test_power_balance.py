"""Energy of populations and its dissipation by collisions (``benchmarks/power_balance.py``)."""

import importlib
from pathlib import Path

import numpy as np
import pytest
import warp as wp

from sim.fluid.fluid import Fluid
from sim.lattice.velocities import D3Q19

SIDE, SPEED = 16, 0.05


@pytest.fixture
def energies(monkeypatch):
    """Energy of a fluid in lattice units and what the next collision dissipates, shape (2,)."""
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "benchmarks"))
    made = importlib.import_module("power_balance").energy_kernel

    def of(fluid):
        out = wp.zeros(fluid.cells, dtype=wp.vec2d, device="cpu")
        state = [fluid.f, fluid.flags, fluid.box, fluid.t, fluid.tau, fluid.magic]
        more = [fluid.smagorinsky**2, 0.0, out]
        wp.launch(made(fluid), dim=fluid.cells, inputs=[*state, *more], device="cpu")
        return out.numpy().sum(axis=0)

    return of


def test_energy_of_a_uniform_flow_is_kinetic_and_is_not_dissipated(energies):
    fluid = Fluid(D3Q19, (SIDE,) * 3, viscosity=0.01, threads=1)
    fluid.set(velocity=np.array([SPEED, 0.0, 0.0]))
    energy, lost = energies(fluid)
    assert energy == pytest.approx(SIDE**3 * SPEED**2 / 2, rel=0.01)
    assert abs(lost) < 1e-6 * energy


@pytest.mark.parametrize("smagorinsky", [0.0, 0.17])
def test_vortices_lose_the_energy_that_collisions_dissipate(energies, smagorinsky):
    """Streaming conserves the energy, so that the balance is exact in every step."""
    x, y, _ = 2 * np.pi * np.indices((SIDE, SIDE, 1)) / SIDE
    flow = SPEED * np.stack([np.cos(x) * np.sin(y), -np.sin(x) * np.cos(y), 0 * x], axis=-1)
    fluid = Fluid(D3Q19, (SIDE,) * 3, viscosity=0.005, smagorinsky=smagorinsky, threads=1)
    fluid.set(velocity=np.broadcast_to(flow, (SIDE, SIDE, SIDE, 3)))
    first, total = energies(fluid)[0], 0.0
    for _ in range(200):
        total += energies(fluid)[1]
        fluid.step()
    left = energies(fluid)[0]
    assert left < 0.9 * first, "something was dissipated"
    assert total == pytest.approx(first - left, rel=1e-3)
