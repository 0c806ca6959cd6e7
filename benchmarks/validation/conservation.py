"""What must be conserved: momentum of a robot and its water, and energy under hard commands."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from benchmarks.validation.case import CPU, LATTICE, Case, Figure, Where, chain, neutral
from sim.fluid.fluid import CS2, Fluid
from sim.fluid.wall import NO_SLIP, Wall
from sim.lattice.velocities import D2Q9, D3Q19, Lattice, Units
from sim.robot.bodies import Bodies
from sim.robot.shape import Hull
from sim.robot.swimmer import CONTROL_S, LEAST_VISCOSITY, SMAGORINSKY
from sim2real.arrays import Array, Integers
from sim2real.servo.parameters import COLUMNS

RADII = np.array([0.085, 0.115, 0.06, 0.03, 0.02])
"""Half-widths at the nose, the joints and the tail's tip, in body lengths."""
SET_POINTS = (0.4, -0.5, 0.6)
"""Set-points in rad, from a straight body at rest."""
_KP, _KD = 0.006, 0.6
"""Gains over the body length squared (cubed in three dimensions), in lattice units."""


def servos(joints: int, kp: float, kd: float) -> Array:
    """Rows of the servo law's parameters."""
    rows = np.zeros((joints, len(COLUMNS)))
    rows[:, COLUMNS.index("kp_Nm_per_rad")] = kp
    rows[:, COLUMNS.index("kd_Nms_per_rad")] = kd
    return rows


def send(bodies: Bodies, angles: Array) -> None:
    """Set-points in force from now on, shape (E, J) or (J,)."""
    sent = bodies.motion.sent.numpy()
    sent[:, :, 0] = angles
    bodies.motion.sent.assign(sent)
    bodies.motion.newest.fill_(0)


class Audit(NamedTuple):
    """Momentum of body and water together, over the sum of all impulses between them.

    Attributes:
        step: Steps since the start, shape (T,).
        linear: Along x and y, shape (T, 2).
        angular: About the box's corner, over impulse times body length, shape (T,).
        bend: Largest joint angle in rad at the end.
    """

    step: Array
    linear: Array
    angular: Array
    bend: float


def momentum_of(fluid: Fluid, bodies: Bodies) -> Array:
    """Momentum of water and robot along x and y, and about the corner of the box."""
    density, u = (field[0].astype(np.float64) for field in fluid.moments())
    x, y = np.arange(float(fluid.size[0])), np.arange(float(fluid.size[1]))
    m = (density[..., None] * u).sum(axis=2)
    spin = (x[:, None] * m[..., 1] - y * m[..., 0]).sum()
    return np.asarray(np.array([*m.sum(axis=(0, 1))[:2], spin]) + bodies.momentum()[0])


def audit(
    lattice: Lattice, length: int, side: int, steps: int, wall: Wall = NO_SLIP, where: Where = CPU
) -> Audit:
    """Move the servos of a neutral robot in a periodic box, oblique to it; look twenty times."""
    flat = lattice.dimensions == 2
    fluid = where.fluid(lattice, (side,) * lattice.dimensions, viscosity=0.005, smagorinsky=0.1)
    hull = chain(np.full(4, length * (1 - RADII[0] - RADII[-1]) / 4), length * RADII)
    hull = Hull(hull.length, hull.half_width, 1.5 * hull.half_height)
    scale = length**2 if flat else 0.15 * length**3
    rows, masses = servos(3, _KP * scale, _KD * scale), neutral(hull, 1.0, LATTICE, flat=flat)
    bodies = Bodies(fluid, hull, masses, LATTICE, servos=rows, wall=wall)
    bodies.place(np.array([[side / 2 + 0.3 * length, side / 2 + 0.2, 0.3, 0.0, 0.0, 0.0]]))
    send(bodies, np.array(SET_POINTS))
    impulse, looks = 0.0, []
    for step in range(1, steps + 1):
        bodies.step()
        impulse += float(np.abs(bodies.motion.force.numpy()[..., :2]).sum())
        if step % (steps // 20) == 0:
            looks.append([step, *(momentum_of(fluid, bodies) / impulse)])
    table = np.array(looks)
    bend = float(np.abs(bodies.motion.q.numpy()[0, 3:]).max())
    return Audit(table[:, 0], table[:, 1:3], table[:, 3] / length, bend)


def momentum(where: Where = CPU) -> Case:
    """In two dimensions for long times, and shorter in three.

    A periodic box conserves linear momentum, but angular momentum only until sound has crossed its
    edge. Single precision loses 4e-9 of the impulses per step.
    """
    side = 160 if where.quick else 320
    near = audit(D2Q9, 32, side, side // 2, where=where)
    left = {"linear, 2D": near.linear, "angular, 2D": near.angular}
    if not where.quick:
        solid = audit(D3Q19, 24, 64, 60, where=where)
        left["linear, 2D, 2000 steps"] = audit(D2Q9, 32, 128, 2000, where=where).linear
        left |= {"linear, 3D": solid.linear, "angular, 3D": solid.angular}
    return Case(
        "Momentum of a three-joint robot and its water",
        "conservation of momentum; the reference is 0",
        f"density ratio 1, free in a periodic box of {side} x {side} cells (2D), 32 cells a body "
        f"length, joints turn to {near.bend:.2f} rad; relative to all impulses on the links",
        [
            Figure(f"momentum left over, {name}", float(np.abs(x).max()), 0.0, 1e-5, scale=1.0)
            for name, x in left.items()
        ],
    )


AMPLITUDE, FREQUENCY_HZ = 0.8, 2.0
KP, KD = 2.2, 0.06
"""Gains in N m/rad and N m s/rad, as of the robots' servos."""
_SHAKEN = {1: (0.085, 0.1, 0.03), 3: (0.085, 0.115, 0.06, 0.025, 0.02)}
_LENGTH_M, _CELL_M, _BOX, _SUBSTEPS = 0.52, 0.02, (96, 64), 10


def commands(seconds: float, joints: int, rng: np.random.Generator) -> Array:
    """Set-points in rad, shape (T, 3, J): square waves in phase, in antiphase, random jumps."""
    periods = round(seconds / CONTROL_S)
    phase = FREQUENCY_HZ * CONTROL_S * np.arange(periods)
    together = np.sign(np.sin(2 * np.pi * (phase + 1e-9)))[:, None] * np.ones(joints)
    turns = together * (-1.0) ** np.arange(joints)
    jumps = rng.uniform(-1, 1, (int(2 * phase[-1]) + 1, joints))[(2 * phase).astype(int)]
    return AMPLITUDE * np.stack([together, turns, jumps], axis=1)


def kinetic_energy(bodies: Bodies) -> Array:
    """Kinetic energy of water and robot in J, with that of compression, shape (E,).

    The water inside the robot moves with it and is counted with the water.
    """
    density, u = (field.astype(np.float64) for field in bodies.fluid.moments())
    cells = 0.5 * (density * (u**2).sum(axis=-1) + CS2 * (density - 1) ** 2)
    units = bodies.units
    water = cells.sum(axis=(1, 2, 3)) * units.mass_kg * units.speed_m_s**2
    mass, twist = bodies.chain.mass.numpy(), bodies.motion.twist.numpy()
    links = mass[..., 0] * (twist[..., :2] ** 2).sum(axis=-1) + mass[..., 1] * twist[..., 2] ** 2
    return np.asarray(water + 0.5 * links.sum(axis=1))


def shake(
    seconds: float, joints: int, rng: np.random.Generator, where: Where = CPU
) -> tuple[Array, Array, Integers]:
    """Work of the servos and kinetic energy in J after each period (T, 3), and stopped cells (3,).

    A neutral robot 26 cells long at the smallest default viscosity, in a box for each of three
    kinds of commands. A servo's work in a step is the torque at its middle times the rotation.
    """
    r = _LENGTH_M * np.array(_SHAKEN[joints])
    hull = chain(np.full(joints + 1, (_LENGTH_M - r[0] - r[-1]) / (joints + 1)), r)
    units = Units(_CELL_M, CONTROL_S / _SUBSTEPS, 0.1)
    more = {"viscosity": LEAST_VISCOSITY, "smagorinsky": SMAGORINSKY}
    fluid = where.fluid(D2Q9, _BOX, boxes=3, **more)
    masses = neutral(hull, _CELL_M, units, flat=True)
    limits, rows = np.tile([-0.9, 0.9], (joints, 1)), servos(joints, KP, KD)
    bodies = Bodies(fluid, hull, masses, units, servos=rows, limits=limits)
    start = np.zeros((3, 3 + joints))
    start[:, :2] = _CELL_M * np.array(_BOX) / 2
    bodies.place(start)
    s, total = bodies.motion, np.zeros(3)
    work, kinetic = [], []
    q, v = s.q.numpy()[:, 3:].copy(), s.v.numpy()[:, 3:].copy()
    for target in commands(seconds, joints, rng):
        send(bodies, target)
        for _ in range(_SUBSTEPS):
            bodies.step()
            after, rate = s.q.numpy()[:, 3:].copy(), s.v.numpy()[:, 3:].copy()
            torque = KP * (target - (q + after) / 2) - KD * (v + rate) / 2
            total += (torque * (after - q)).sum(axis=1)
            q, v = after, rate
        work.append(total.copy())
        kinetic.append(kinetic_energy(bodies))
    return np.array(work), np.array(kinetic), fluid.stopped.numpy()


def hard_commands(where: Where = CPU) -> Case:
    """A minute of square waves and random jumps: stable, and no energy out of nothing.

    Explicit coupling fails for a body as light as the water that it displaces. The servos' work
    must be at least the kinetic energy of body and water at all times; the rest has become heat.
    """
    seconds = 3.0 if where.quick else 60.0
    rng = np.random.default_rng(5)
    figures = []
    for joints in (1, 3):
        work, kinetic, stopped = shake(seconds, joints, rng, where)
        heat, whole = work - kinetic, work.max(axis=0)
        returned = float(np.max((np.maximum.accumulate(heat) - heat) / whole))
        found = {
            "boxes stopped": (float((stopped >= 0).sum()), 0.0),
            "kinetic energy beyond the servos' work, share of all work":
                (max(0.0, float(np.max(-heat / whole))), 1e-4),
            "heat that turned to motion again, share of all work": (returned, 0.01),
        }  # fmt: skip
        figures += [
            Figure(f"{joints} joint(s): {name}", ours, 0.0, bar, 1.0)
            for name, (ours, bar) in found.items()
        ]
    return Case(
        "Hard commands at density ratio 1",
        "conservation of energy; no published figures",
        f"+-{AMPLITUDE} rad at {FREQUENCY_HZ:g} Hz for {seconds:g} s, square and random, kp "
        f"{KP:g} N m/rad, 26 cells a body length, {_SUBSTEPS} steps a control period, viscosity "
        f"{LEAST_VISCOSITY:g}",
        figures,
    )
