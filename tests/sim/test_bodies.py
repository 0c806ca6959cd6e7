"""Bodies in the fluid: what must be conserved, what must be equal, what is known exactly."""

from functools import partial

import numpy as np
import pytest

from benchmarks.validation.case import Where
from benchmarks.validation.conservation import momentum, send, shake
from benchmarks.validation.still import driven_cylinder
from benchmarks.validation.swimmers import advance, swim, wave
from sim.fluid.fluid import Fluid
from sim.lattice.velocities import D2Q9, D3Q19, Units
from sim.robot.bodies import KINEMATIC, Bodies, Masses
from sim.robot.shape import Hull, displaced
from sim2real.servo.parameters import COLUMNS

LENGTH = 26.0
"""Body length in cells; units are those of the lattice."""


def fish(fluid, *, radii=(0.085, 0.115, 0.06, 0.025, 0.02), servo=(), limits=None, **more):
    """Four links at density ratio 1, straight, in the middle of each box."""
    r = np.array(radii) * LENGTH
    half = np.stack([r[:-1], (r[:-1] + r[1:]) / 2, r[1:]], axis=1)
    hull = Hull(np.full(4, (LENGTH - r[0] - r[-1]) / 4), half, half)
    true = displaced(hull, 1.0, 0.0, True)
    rows = np.zeros((fluid.boxes, 3, len(COLUMNS)))
    for name, value in servo:
        rows[:, :, COLUMNS.index(name)] = np.reshape(value, (-1, 1))
    masses = Masses(true[:, 0], true[:, 2], true[:, 1])
    units = Units(1.0, 1.0, 1.0, 1.0)
    bodies = Bodies(fluid, hull, masses, units, servos=rows, limits=limits, **more)
    start = np.zeros((fluid.boxes, 6))
    start[:, :2] = fluid.size[0] // 2
    bodies.place(start)
    return bodies


def water(side=80, boxes=1, **more):
    return Fluid(D2Q9, (side, side), viscosity=0.02, smagorinsky=0.1, boxes=boxes, **more)


STIFF = (("kp_Nm_per_rad", 4.0), ("kd_Nms_per_rad", 400.0))


def test_momentum_of_body_and_water_is_conserved():
    for figure in momentum(Where(quick=True)).figures:
        assert figure.met, figure


def test_servos_pay_for_all_motion():
    work, kinetic, stopped = shake(1.0, 3, np.random.default_rng(1))
    lost = work - kinetic
    assert np.all(stopped == -1)
    assert np.all(lost > 0) and np.all(kinetic[-1] > 1e-3)
    assert np.all(np.diff(lost, axis=0) > -1e-3 * work[-1])


def test_a_driven_cylinder_moves_as_stokes_says():
    figure = driven_cylinder(Where(quick=True)).figures[0]
    assert figure.met, figure


@pytest.mark.parametrize("lattice", [D2Q9, D3Q19])
def test_a_disc_and_a_ball_displace_what_they_should(lattice):
    flat = lattice is D2Q9
    hull = Hull(np.zeros(1), np.full((1, 3), 6.0), np.full((1, 3), 6.0))
    volume, centre, second = displaced(hull, 1.0, 0.0, flat)[0]
    exact = (np.pi * 36, np.pi * 6**4 / 2) if flat else (4 / 3 * np.pi * 216, 8 / 15 * np.pi * 6**5)
    assert volume == pytest.approx(exact[0], rel=0.02)
    assert second == pytest.approx(exact[1], rel=0.04)
    assert centre == pytest.approx(0.0, abs=1e-9)


def test_prescribed_joints_turn_as_prescribed():
    bodies = fish(water())
    bodies.prescribe([0, 0, 0, 0.001, -0.002, 0.003])
    for _ in range(40):
        bodies.step(KINEMATIC)
    assert bodies.motion.q.numpy()[0, 3:] == pytest.approx([0.04, -0.08, 0.12])
    assert np.abs(bodies.motion.q.numpy()[0, :3] - [40, 40, 0]).max() > 1e-3


def test_joints_stay_within_their_limits():
    bodies = fish(water(), servo=STIFF, limits=np.tile([-0.1, 0.1], (3, 1)))
    send(bodies, [0.2, -0.2, 0.2])
    for _ in range(900):
        bodies.step()
        assert np.abs(bodies.motion.q.numpy()[0, 3:]).max() < 0.1 + 1e-9
    assert bodies.motion.q.numpy()[0, 3:] == pytest.approx([0.1, -0.1, 0.1], abs=1e-6)
    assert bodies.fluid.stopped.numpy()[0] == -1


def test_dry_friction_stops_a_joint_short():
    still = fish(water(), servo=(*STIFF, ("coulomb_friction.torque_Nm", 0.4)))
    send(still, [0.08, -0.08, 0.08])
    moved = fish(water(), servo=(*STIFF, ("coulomb_friction.torque_Nm", 0.2)))
    send(moved, [0.2, -0.2, 0.2])
    for bodies in (still, moved):
        for _ in range(600):
            bodies.step()
    assert np.abs(still.motion.q.numpy()[0, 3:]).max() < 1e-9
    short = 0.2 - np.abs(moved.motion.q.numpy()[0, 3:])
    assert np.all(short > 0.02) and np.all(short < 0.06)


def test_boxes_of_a_batch_are_as_if_alone():
    viscosity, gains = np.array([0.01, 0.05]), np.array([4.0, 2.0])
    angles = np.array([[0.3, 0.3, 0.3], [-0.2, 0.1, 0.4]])

    def damped(kp):
        return (("kp_Nm_per_rad", kp), ("kd_Nms_per_rad", 400.0))

    together = fish(Fluid(D2Q9, (64, 64), viscosity=viscosity, boxes=2), servo=damped(gains))
    alone = [
        fish(Fluid(D2Q9, (64, 64), viscosity=v), servo=damped(kp))
        for v, kp in zip(viscosity, gains, strict=True)
    ]
    send(together, angles)
    for one, angle in zip(alone, angles, strict=True):
        send(one, angle)
    for bodies in (together, *alone):
        for _ in range(60):
            bodies.step()
    both = together.motion.q.numpy()
    assert np.array_equal(both, np.concatenate([one.motion.q.numpy() for one in alone]))
    assert not np.array_equal(both[0, 3:], both[1, 3:])


def two_ways(headings, sides):
    """How two robots move whose joints turn alike, or as mirror images: shape (2, 3)."""
    bodies = fish(water(boxes=2))
    start = bodies.motion.q.numpy().copy()
    start[:, 2] = headings
    bodies.place(start)
    rates = np.zeros_like(start)
    for step in range(240):
        bend = np.array([0.001, -0.002, 0.003]) * np.cos(0.01 * step)
        rates[:, 3:] = np.outer(sides, bend)
        bodies.prescribe(rates)
        bodies.step(KINEMATIC)
    return (bodies.motion.q.numpy() - start)[:, :3]


def test_the_mirror_image_swims_the_mirrored_way():
    moved, mirrored = two_ways([0.0, 0.0], [1, -1])
    assert np.abs(moved).min() > 0.005
    assert mirrored == pytest.approx(moved * [1, -1, -1], abs=1e-3 * np.abs(moved).max())


def test_the_rotated_robot_swims_the_rotated_way():
    (x, y, turned), rotated = two_ways([0.3, 0.3 + np.pi / 2], [1, 1])
    assert rotated == pytest.approx([-y, x, turned], abs=1e-3 * np.hypot(x, y))


def test_a_wave_swims_head_first_and_its_reverse_hardly():
    more = {"box": (4.0, 3.0), "steps": 600, "cycles": 4}
    forward, reverse = advance(swim([wave, partial(wave, ahead=-1.0)], 26, **more))
    assert forward > 0.08
    assert reverse < forward / 2
