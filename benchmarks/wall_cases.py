"""Cases with known answers for wall models of bodies: spheroids, foils, plates, tanks.

    python benchmarks/wall_cases.py OUT.json [--wall ghost] [--device cuda:0] [--only foil plate]

All cases take some minutes of a GPU. Each result is printed as it comes; a run with the same OUT
skips the results that it has. ``--tiny`` checks on a CPU that the cases run.

Known answers: a spheroid without friction has no drag in steady motion, in any frame of reference,
and with friction 1.13 times that of a plate (Hoerner, Fluid-Dynamic Drag, 1965); it carries water
as Lamb's theory says. Foils that pitch by 0.14 rad: Garrick, NACA Report 567 (1936). Sections at
rest, at a Reynolds number of 8e4 to 1.6e5: Sheldahl and Klimas, SAND80-2114 (1981). A square plate
across the stream: Hoerner, 1.17.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from fluid_speed import MODEL, ROBOT, WALLS
from resolution import WAVES

from sim.cases import hard_commands as shaking
from sim.cases import momentum, spheroid
from sim.fluid.fluid import Fluid
from sim.fluid.wall import Wall
from sim.lattice.cell import GHOST, KIND
from sim.lattice.units import Units
from sim.lattice.velocities import D2Q9, D3Q19
from sim.robot.bodies import HELD, Bodies, Masses
from sim.robot.rows import masses, servo_rows
from sim.robot.shape import Hull
from sim.robot.swimmer import CONTROL_S, Swimmer
from sim2real.arrays import Array
from sim2real.output import write_json

LATTICE_UNITS = Units(1.0, 1.0, 1.0, 1.0)
PITCH_RAD = 0.14
Result = dict[str, Any]


def light(links: int) -> Masses:
    """Masses of bodies whose motion is prescribed."""
    return Masses(np.ones(links), np.ones(links), np.zeros(links))


def towed(
    length: int, wall: Wall, device: str, *, body: float = 1.0, degrees: float = 0.0
) -> float:
    """Drag coefficient of a spheroid on its wetted area: 0 in ideal fluid, in any frame."""
    moved, drag = spheroid.drag(length, wall, device=device, threads=1, body=body, degrees=degrees)
    return float(drag[moved > moved[-1] / 2].mean())


def friction(length: int, walls: tuple[Wall, Wall], device: str) -> Result:
    """Friction of a towed spheroid over Hoerner's, from its drag with and without."""
    rough, bare = (towed(length, wall, device) for wall in walls)
    return {"over_hoerner": (rough - bare) / (spheroid.slipping() * spheroid.plate())}


def frame(length: int, wall: Wall, device: str, body: float, degrees: float) -> Result:
    """Drag coefficient in a frame of reference, see ``spheroid.drag``."""
    return {"drag_coefficient": towed(length, wall, device, body=body, degrees=degrees)}


def carried(length: int, wall: Wall, device: str) -> Result:
    """Added mass of a spheroid, with its own, end-on and broadside: 1.045 and 1.918."""
    end, broadside = spheroid.masses(length, wall, device=device, threads=1)
    return {"end_on": float(end), "broadside": float(broadside)}


def tank(cell_m: float, wall: Wall, device: str, steps: int) -> Result:
    """Largest relative change of the mass of a walled box, and of its density outside the robot."""
    swimmer = Swimmer(
        ROBOT, MODEL, n_envs=2, cell_m=cell_m, device=device, wall=wall, walls=True,
        box_m=(1.5, 1.0, 0.4),
    )  # fmt: skip
    fluid, found = swimmer.fluid, []
    periods = max(1, steps // swimmer.substeps)
    for k in range(periods):
        t = k * CONTROL_S  # turns to and fro, so that it stays off the walls
        turning = WAVES[1].command(t) * np.sin(np.pi * t / 2)
        swimmer.step(np.array([WAVES[0].command(t) + 0.2 * np.sign(np.sin(t)), turning]))
        if (k + 1) % max(1, periods // 40) == 0:
            density = fluid.moments()[0].astype(np.float64)
            nx, ny, nz = fluid.size
            flags = fluid.flags.numpy().reshape(2, nz, ny, nx).transpose(0, 3, 2, 1)
            water = (flags & KIND) == 0
            kinds = (water, water & ((flags & GHOST) == 0))
            found.append([[(density[e][k[e]] - 1).mean() for k in kinds] for e in range(2)])
    most = np.abs(np.array(found)).max(axis=(0, 1))
    return {"all": float(most[0]), "outside": float(most[1]), "steps": periods * swimmer.substeps}


def hard_commands(
    cell_m: float, wall: Wall, device: str, seconds: float, *, scale: float = 1.0, seed: int = 5
) -> Result:
    """Three kinds of hard commands at four density ratios; -1 where a box did not stop."""
    ratios = np.repeat([0.5, 1.0, 2.0, 10.0], 3)
    E, J = ratios.size, len(ROBOT.joints)
    swimmer = Swimmer(ROBOT, MODEL, n_envs=E, cell_m=cell_m, device=device, wall=wall)
    usual = masses(ROBOT, [MODEL] * E, swimmer.hull)
    ratio = ratios[:, None]
    heavy = Masses(usual.mass * ratio, usual.inertia * ratio, usual.com)
    rows = servo_rows(ROBOT, [MODEL] * E)
    swimmer.bodies.adopt(np.arange(E), heavy, rows, swimmer.outside)
    swimmer.reset()
    for kinds in scale * shaking.commands(seconds, J, np.random.default_rng(seed)):
        swimmer.step(np.tile(kinds, (4, 1)))
    stopped = swimmer.state().stopped
    return {"density_ratio": ratios.tolist(), "stopped_in_cell": stopped.tolist()}


def section(chord: float, thickness: float, links: int = 8) -> tuple[Hull, float]:
    """A NACA section of four digits in metres, ``chord`` long, and the radius of its nose."""

    def half(x: Array) -> Array:
        series = np.array([0.2969, -0.126, -0.3516, 0.2843, -0.1036])
        powers = np.stack([np.sqrt(x), x, x**2, x**3, x**4])
        return np.asarray(5 * thickness * chord * (series @ powers))

    nose = 1.1019 * thickness**2
    ends = nose + (0.995 - nose) * (0.5 - 0.5 * np.cos(np.linspace(0, np.pi, links + 1)))
    width = np.stack([half(ends[:-1]), half((ends[:-1] + ends[1:]) / 2), half(ends[1:])], axis=1)
    width[0, 0] = nose * chord
    return Hull(np.diff(ends) * chord, width, np.full_like(width, 1e6)), nose * chord


def foil(
    chord: int, thickness: float, wall: Wall, device: str, *, k: float = 0.0, lengths: float = 6.0
) -> Result:
    """Coefficients of drag and of pitching power on the chord of a foil towed in two dimensions.

    It pitches about a quarter of its chord at the reduced frequency k = pi f c / U unless k is 0.
    """
    speed = 0.04
    units = Units(0.4 / chord, speed / chord, 0.4 / chord)  # a chord of 0.4 m, in water
    cells = (round((lengths + 3) * chord), 4 * chord)
    fluid = Fluid(D2Q9, cells, viscosity=3e-4, smagorinsky=0.17, device=device)
    hull, nose = section(0.4, thickness)
    links = hull.length.size
    bodies = Bodies(fluid, hull, light(links), units, wall=wall)
    steps = round(lengths * chord / speed)
    counted, omega = steps // 2, 2 * k * speed / chord
    if k:  # whole periods in the second half
        period = 2 * np.pi / omega
        steps = round(max(2, round(steps / period)) * period)
        counted = steps - round(max(1, steps // 2 // round(period)) * period)
    t = np.arange(steps + 1)
    angle = PITCH_RAD * np.sin(omega * t) * np.minimum(1.0, t / (0.5 * chord / speed))
    moved = np.cumsum(speed * np.minimum(1.0, (t[1:] - 0.5) / (0.3 * chord / speed)))
    pivot = np.array(
        [cells[0] - 1.3 * chord + np.append(0.0, moved), np.full(t.size, cells[1] / 2)]
    )
    head = (0.1 - nose) / units.cell_m  # from the front end of the axis to the pivot
    at = np.stack(
        [pivot[0] + head * np.cos(angle), pivot[1] + 0.2 + head * np.sin(angle), angle], 1
    )
    at *= [units.cell_m, units.cell_m, 1.0]
    start, rates, found = np.zeros((1, 2 + links)), np.zeros(2 + links), np.zeros((steps, 2))
    start[0, :3] = at[0]
    bodies.place(start)
    for n in range(steps):
        rates[:3] = (at[n + 1] - at[n]) / units.step_s
        bodies.prescribe(rates)
        bodies.step(HELD)
        if n >= counted:
            force, twist = bodies.motion.force.numpy()[0], bodies.motion.twist.numpy()[0]
            found[n] = -force[:, 0].sum(), -(force * twist).sum()
    U = speed * units.speed_m_s
    unit = 0.5 * 1000.0 * U**2 * 0.4 * units.depth_m
    drag, power = found[counted:].mean(axis=0) / [unit, unit * U]
    if fluid.stopped.numpy()[0] >= 0:
        drag = power = np.nan
    return {"drag_coefficient": float(drag), "power_coefficient": float(power - drag)}


def plate(side: int, wall: Wall, device: str, *, lengths: float = 10.0) -> Result:
    """Drag coefficient of a square plate one cell thick, in three parts of the second half."""
    speed, cells = 0.05, (round((lengths + 6) * side), 6 * side, 6 * side)
    fluid = Fluid(D3Q19, cells, viscosity=3e-4, smagorinsky=0.17, device=device)
    hull = Hull(np.array([side - 1.0]), np.full((1, 3), 0.5), np.full((1, 3), side / 2))
    middle = (cells[2] - 1) / 2 + 0.1
    bodies = Bodies(fluid, hull, light(1), LATTICE_UNITS, middle=middle, wall=wall)
    bodies.place(np.array([[3.0 * side + 0.2, cells[1] / 2 + side / 2, np.pi / 2]]))
    steps = round(lengths * side / speed)
    force = np.zeros(steps)
    for n in range(steps):
        bodies.prescribe(np.array([speed * min(1.0, n * speed / side), 0.0, 0.0]))
        bodies.step(HELD)
        force[n] = -bodies.motion.force.numpy()[0, :, 0].sum()
    parts = np.array_split(force[steps // 2 :] / (0.5 * speed**2 * side**2), 3)
    return {"drag_coefficient": [float(part.mean()) for part in parts]}


def conserved(length: int, side: int, steps: int, wall: Wall, device: str) -> Result:
    """Momentum of a robot and its water that is missing, relative to all impulses."""
    audit = momentum.audit(D3Q19, length, side, steps, wall, device=device)
    half = audit.angular.size // 2
    return {"linear": float(np.abs(audit.linear).max()),
            "angular": float(np.abs(audit.angular[:half]).max())}  # fmt: skip


def cases(wall: Wall, device: str, tiny: bool) -> dict[str, Callable[[], Result]]:
    """All cases by their names."""
    bare = Wall(slip=True, ghosts=wall.ghosts)
    most, short = (24, 0.3) if tiny else (96, 6.0)
    jobs: dict[str, Callable[[], Result]] = {}
    for length in (12,) if tiny else (24, 48, 96):
        thick = f"{length / 6:g} cells thick"
        jobs[f"friction, spheroid {thick}"] = partial(friction, length, (wall, bare), device)
        for name, body in {"towed": 1.0, "in a stream": 0.0}.items():
            for degrees in (0.0, 20.0):
                jobs[f"spheroid {name} at {degrees:g} degrees, {thick}"] = partial(
                    frame, length, bare, device, body, degrees
                )  # fmt: skip
        if length > 24:
            jobs[f"carried mass, spheroid {thick}"] = partial(carried, length, bare, device)
    cell_m = 0.04 if tiny else 0.02
    jobs["mass of a tank"] = partial(tank, cell_m, wall, device, 20 if tiny else 10_000)
    hard = partial(hard_commands, wall=wall, device=device, seconds=0.1 if tiny else 60.0)
    jobs["hard commands"] = partial(hard, cell_m)
    jobs["hard commands, 1.3 times as large"] = partial(hard, cell_m, scale=1.3)
    jobs["hard commands, smaller cells"] = partial(hard, 0.75 * cell_m)
    for seed in (6, 7):
        jobs[f"hard commands, seed {seed}"] = partial(hard, cell_m, seed=seed)
    size = (16, 32, 20) if tiny else (48, 128, 200)
    jobs["momentum"] = partial(conserved, *size, wall, device)
    for side in (8,) if tiny else (12, 24):
        jobs[f"plate, {side} cells"] = partial(
            plate, side, bare, device, lengths=short + 4 * (not tiny)
        )
    for chord in (most,) if tiny else (most, most // 2):
        for digits in (12, 21):
            name = f"foil NACA 00{digits} at rest, {chord} cells"
            jobs[name] = partial(foil, chord, digits / 100, wall, device, lengths=short)
        for k in (0.0, 2.0, 4.0):
            name = f"foil NACA 0012 without friction, k {k:g}, {chord} cells"
            jobs[name] = partial(foil, chord, 0.12, bare, device, k=k, lengths=short)
    return jobs


def main() -> None:
    """Run the cases that OUT lacks, print and write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--wall", choices=WALLS, default="default")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--only", nargs="*", help="first words of the cases to run")
    parser.add_argument("--tiny", action="store_true", help="seconds on a CPU: do the cases run?")
    options = parser.parse_args()
    results = json.loads(options.out.read_text()) if options.out.exists() else {}
    for name, run in cases(WALLS[options.wall], options.device, options.tiny).items():
        first = name.split(",")[0].split()[0]
        if name in results or (options.only and first not in options.only):
            continue
        results[name] = run()
        print(f"{name}: {json.dumps(results[name])}", flush=True)
        write_json(options.out, results)


if __name__ == "__main__":
    main()
