import numpy as np
import pytest

from sim.fluid.fluid import Fluid
from sim.fluid.wall import SLIP, Wall
from sim.lattice.velocities import D2Q9, Units
from sim.robot.bodies import FREE, HELD, Bodies
from sim.robot.rows import Masses
from sim.robot.shape import Hull

LIGHT = Masses(np.ones(1), np.ones(1), np.zeros(1))


def put(length, half_width, wall, units=None, masses=LIGHT, size=(160, 96)):
    half = np.full((1, 3), float(half_width))
    fluid = Fluid(D2Q9, size, viscosity=1e-3, smagorinsky=0.17)
    bodies = Bodies(fluid, Hull(np.array([float(length)]), half, half), masses,
                    units or Units(1.0, 1.0, 1.0, 1.0), wall=wall)  # fmt: skip
    bodies.place(np.array([[size[0] / 2 + 0.3, size[1] / 2 + 0.2, 0.0]]) * bodies.units.cell_m)
    return bodies


def drag(wall, rough=0.0):
    units = Units(0.01, 0.001, 0.01)  # 0.5 m/s: 0.05 cells a step
    bodies = put(0.5, 0.02, wall, units)
    bodies.chain.rough.fill_(rough)
    force = []
    for k in range(600):
        bodies.prescribe([0.5 * min(1.0, k / 100), 0.0, 0.0])
        bodies.step(HELD)
        force.append(bodies.motion.force.numpy()[0, 0, 0])
    return -np.mean(force[300:])


def test_friction_is_that_of_its_line_and_the_material_adds_to_it():
    plain, laminar, turbulent = (
        drag(Wall(True, line)) for line in ("none", "laminar", "turbulent")
    )
    rough = drag(Wall(True, "none"), rough=0.05)
    assert plain < laminar < turbulent < rough
    speed, area = 0.5, 2 * 0.54 * 0.01
    whole = 0.5 * 998.0 * speed**2 * area
    assert 0.5 < (rough - plain) / (0.05 * whole) < 1.0  # beside the wall the slip is less


def test_what_the_water_gets_the_body_loses():
    bodies = put(
        16.0, 4.0, SLIP, masses=Masses(np.full(1, 150.0), np.full(1, 4e3), np.full(1, 8.0))
    )
    bodies.push(np.array([[0.05, 0.02, 0.1]]))
    for _ in range(100):
        bodies.step(FREE)
    bodies.push(np.zeros(3))
    rho, u = bodies.fluid.moments()
    before = (rho[..., None] * u).sum(axis=(0, 1, 2, 3))[:2] + bodies.momentum()[0, :2]
    for _ in range(300):
        bodies.step(FREE)
    rho, u = bodies.fluid.moments()
    after = (rho[..., None] * u).sum(axis=(0, 1, 2, 3))[:2] + bodies.momentum()[0, :2]
    assert after == pytest.approx(before, abs=1e-3 * np.abs(before).max())
    assert before == pytest.approx([5.0, 2.0], rel=0.01)
