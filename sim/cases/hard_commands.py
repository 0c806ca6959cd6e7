"""Extreme commands for a minute: the simulation must be stable and must not create energy.

Explicit coupling fails for a body as light as the water that it displaces. The servos' work must be
at least the kinetic energy of body and water at all times; the rest has become heat.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.cases.case import Case, Curve, Figure
from sim.fluid.fluid import CS2, Fluid
from sim.lattice.units import WATER_KG_M3, Units
from sim.lattice.velocities import D2Q9
from sim.robot.bodies import Bodies, Masses
from sim.robot.shape import Hull, displaced
from sim.robot.swimmer import CONTROL_S, LEAST_VISCOSITY, SMAGORINSKY
from sim2real.arrays import Array, Integers
from sim2real.servo.parameters import COLUMNS

LENGTH_M, DEPTH_M, CELL_M = 0.52, 0.1, 0.02
AMPLITUDE, FREQUENCY_HZ = 0.8, 2.0
KP, KD = 2.2, 0.06
"""Gains in N m/rad and N m s/rad, as of the robots' servos."""
LIMIT = 0.9
_RADII = {1: (0.085, 0.1, 0.03), 3: (0.085, 0.115, 0.06, 0.025, 0.02)}
_BOX, _SUBSTEPS = (96, 64), 10


@dataclass(frozen=True)
class Shaken:
    """Energy in J of each robot and its water, at the end of each control period.

    Attributes:
        time: In s, shape (T,).
        work: Work of the servos since the start, shape (T, E).
        kinetic: Energy of body and water, with that of compression, shape (T, E).
        stopped: Cell of supersonic flow at which a box was stopped, or -1, shape (E,).
        fastest: Largest joint rate in rad/s, shape (E,).
    """

    time: Array
    work: Array
    kinetic: Array
    stopped: Integers
    fastest: Array


def commands(seconds: float, joints: int, rng: np.random.Generator) -> Array:
    """Set-points in rad, shape (T, 3, J): square waves in phase, in antiphase, random jumps."""
    periods = round(seconds / CONTROL_S)
    phase = FREQUENCY_HZ * CONTROL_S * np.arange(periods)
    together = np.sign(np.sin(2 * np.pi * (phase + 1e-9)))[:, None] * np.ones(joints)
    turns = together * (-1.0) ** np.arange(joints)
    jumps = rng.uniform(-1, 1, (int(2 * phase[-1]) + 1, joints))[(2 * phase).astype(int)]
    return AMPLITUDE * np.stack([together, turns, jumps], axis=1)


def robot(joints: int, boxes: int, *, device: str, threads: int) -> Bodies:
    """A robot at density ratio 1, 26 cells long, in boxes with the smallest default viscosity."""
    r = LENGTH_M * np.array(_RADII[joints])
    half = np.stack([r[:-1], (r[:-1] + r[1:]) / 2, r[1:]], axis=1)
    links = joints + 1
    hull = Hull(np.full(links, (LENGTH_M - r[0] - r[-1]) / links), half, half)
    units = Units(CELL_M, CONTROL_S / _SUBSTEPS, DEPTH_M)
    fluid = Fluid(
        D2Q9,
        _BOX,
        boxes=boxes,
        viscosity=LEAST_VISCOSITY,
        smagorinsky=SMAGORINSKY,
        device=device,
        threads=threads,
    )
    water = displaced(hull, CELL_M, 0.0, True) * [WATER_KG_M3 * DEPTH_M, 1, WATER_KG_M3 * DEPTH_M]
    rows = np.zeros((joints, len(COLUMNS)))
    rows[:, COLUMNS.index("kp_Nm_per_rad")] = KP
    rows[:, COLUMNS.index("kd_Nms_per_rad")] = KD
    masses = Masses(water[:, 0], water[:, 2], water[:, 1])
    limits = np.tile([-LIMIT, LIMIT], (joints, 1))
    bodies = Bodies(fluid, hull, masses, units, servos=rows, limits=limits)
    start = np.zeros((boxes, 3 + joints))
    start[:, :2] = CELL_M * np.array(_BOX) / 2
    bodies.place(start)
    bodies.motion.newest.fill_(0)
    return bodies


def kinetic_energy(bodies: Bodies) -> Array:
    """Kinetic energy of water and robot in J, shape (E,).

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
    seconds: float, joints: int, rng: np.random.Generator, *, device: str = "cpu", threads: int = 2
) -> Shaken:
    """Simulate one robot with three kinds of commands, with energies at every step of the lattice.

    A servo's work in a step is the torque at the middle of the step times the rotation.
    """
    set_points = commands(seconds, joints, rng)
    bodies = robot(joints, set_points.shape[1], device=device, threads=threads)
    s = bodies.motion
    work = np.zeros(set_points.shape[1])
    fastest = np.zeros(set_points.shape[1])
    stored = s.sent.numpy().copy()
    rows = []
    q, v = s.q.numpy()[:, 3:].copy(), s.v.numpy()[:, 3:].copy()
    for k, target in enumerate(set_points):
        stored[:, :, 0] = target
        s.sent.assign(stored)
        for _ in range(_SUBSTEPS):
            bodies.step()
            after, rate = s.q.numpy()[:, 3:].copy(), s.v.numpy()[:, 3:].copy()
            torque = KP * (target - (q + after) / 2) - KD * (v + rate) / 2
            work += (torque * (after - q)).sum(axis=1)
            fastest = np.maximum(fastest, np.abs(rate).max(axis=1))
            q, v = after, rate
        rows.append([(k + 1) * CONTROL_S, *work, *kinetic_energy(bodies)])
    table = np.array(rows)
    boxes = work.size
    return Shaken(
        table[:, 0], table[:, 1 : 1 + boxes], table[:, 1 + boxes :],
        bodies.fluid.stopped.numpy(), fastest,
    )  # fmt: skip


def run(*, device: str = "cpu", threads: int = 2, quick: bool = False) -> Case:
    """One joint and three, each with square waves in phase, in antiphase and random jumps."""
    seconds = 3.0 if quick else 60.0
    rng = np.random.default_rng(5)
    figures, curves = [], []
    for joints in (1, 3):
        result = shake(seconds, joints, rng, device=device, threads=threads)
        name = f"{joints} joint{'s' if joints > 1 else ''}"
        excess = np.max((result.kinetic - result.work) / result.work.max(axis=0))
        share = float((result.kinetic / np.maximum(result.work, 1e-12)).max())
        heat = result.work - result.kinetic
        returned = np.max((np.maximum.accumulate(heat) - heat) / result.work.max(axis=0))
        figures += [
            Figure(f"{name}: boxes stopped", float((result.stopped >= 0).sum()), 0.0, 0.0, 1.0),
            Figure(
                f"{name}: kinetic energy beyond the servos' work, share of all work",
                max(0.0, float(excess)), 0.0, 1e-4, 1.0,
            ),
            Figure(
                f"{name}: heat that turned to motion again, share of all work",
                float(returned), 0.0, 0.01, 1.0,
            ),
            Figure(f"{name}: largest kinetic energy over work", share, 1.0),
        ]  # fmt: skip
        curves.append(
            Curve(
                f"{name}, random: kinetic energy; reference: servos' work", "time (s)",
                "energy (J)", result.time, result.kinetic[:, 2], result.time, result.work[:, 2],
            )
        )  # fmt: skip
    return Case(
        name="hard_commands",
        title="Hard commands at density ratio 1",
        source="conservation of energy; no published figures",
        setup=f"+-{AMPLITUDE} rad at {FREQUENCY_HZ:g} Hz for {seconds:g} s, square and random, "
        f"kp {KP:g} N m/rad, 26 cells a body length, {_SUBSTEPS} steps a control period, "
        f"viscosity {LEAST_VISCOSITY:g}",
        figures=tuple(figures),
        curves=tuple(curves),
    )
