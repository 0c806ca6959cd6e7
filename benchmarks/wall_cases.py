"""Cases with known answers for wall models of bodies: spheroids, foils, plates, tanks.

    python benchmarks/wall_cases.py OUT.json [--wall forcing] [--device cuda:0] [--only foil plate]

All cases take some minutes of a GPU. Each result is printed as it comes; a run with the same OUT
skips the results that it has. ``--tiny`` checks on a CPU that the cases run.

The spheroids, foils and plates are those of ``sim2real validate``; ``sim/cases`` has their known
answers and the sources. The friction of a spheroid is compared with Hoerner's, 1.13 times that of a
plate (Fluid-Dynamic Drag, 1965).
"""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from fluid_speed import MODEL, ROBOT, WALLS
from harness import command_line
from resolution import WAVES

from sim.cases import foil, momentum, plate, spheroid
from sim.cases import hard_commands as shaking
from sim.fluid.wall import Wall
from sim.lattice.cell import GHOST, KIND
from sim.lattice.velocities import D3Q19
from sim.robot.bodies import Masses
from sim.robot.rows import masses, servo_rows
from sim.robot.swimmer import CONTROL_S, Swimmer
from sim2real.output import write_json

Result = dict[str, Any]


def friction(length: int, wall: Wall, device: str) -> Result:
    """Friction of a towed spheroid over Hoerner's."""
    return {"over_hoerner": spheroid.friction(length, wall, device=device, threads=1)}


def frame(
    length: int, wall: Wall, device: str, body: float, degrees: float = 0.0, steps: int = 1
) -> Result:
    """Drag coefficient of a spheroid on its wetted area: 0 in ideal fluid, in any frame.

    ``steps`` is the number of time steps in place of one.
    """
    speed = spheroid.SPEED / steps
    found = spheroid.drag(
        length, wall, body=body, degrees=degrees, speed=speed, device=device, threads=1
    )
    return {"drag_coefficient": spheroid.steady(*found)}


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


def pitching(chord: int, thickness: float, wall: Wall, device: str, **motion: float) -> Result:
    """Coefficients of drag and of pitching power of a foil, see ``foil.coefficients``."""
    drag, power = foil.coefficients(chord, thickness, wall, device=device, threads=1, **motion)
    return {"drag_coefficient": drag, "power_coefficient": power}


def across(side: int, wall: Wall, device: str, lengths: float) -> Result:
    """Drag coefficient of a square plate, in three parts of the second half."""
    _, drag = plate.drag(side, wall, lengths=lengths, device=device, threads=1)
    parts = np.array_split(drag[drag.size // 2 :], 3)
    return {"drag_coefficient": [float(part.mean()) for part in parts]}


def conserved(length: int, side: int, steps: int, wall: Wall, device: str) -> Result:
    """Momentum of a robot and its water that is missing, relative to all impulses.

    A periodic box conserves angular momentum until sound, at 1 / sqrt(3) cells a step, has crossed
    its edge; the robot's front is 0.45 lengths from the middle.
    """
    audit = momentum.audit(D3Q19, length, side, steps, wall, device=device)
    inside = audit.step < np.sqrt(3) * (side / 2 - 0.45 * length)
    return {"linear": float(np.abs(audit.linear).max()),
            "angular": float(np.abs(audit.angular[inside]).max())}  # fmt: skip


def cases(wall: Wall, device: str, tiny: bool) -> dict[str, Callable[[], Result]]:
    """All cases by their names."""
    bare = Wall(slip=True, ghosts=wall.ghosts)
    most, short = (24, 0.3) if tiny else (96, 6.0)
    jobs: dict[str, Callable[[], Result]] = {}
    for length in (12,) if tiny else (24, 48, 96):
        thick = f"{length / 6:g} cells thick"
        jobs[f"friction, spheroid {thick}"] = partial(friction, length, wall, device)
        for name, body in {"towed": 1.0, "in a stream": 0.0}.items():
            for degrees in (0.0, 20.0):
                jobs[f"spheroid {name} at {degrees:g} degrees, {thick}"] = partial(
                    frame, length, bare, device, body, degrees
                )  # fmt: skip
            for steps in () if tiny else (2, 4):
                jobs[f"spheroid {name}, steps 1/{steps} as long, {thick}"] = partial(
                    frame, length, bare, device, body, steps=steps
                )
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
            across, side, bare, device, lengths=short + 4 * (not tiny)
        )
    for chord in (most,) if tiny else (most, most // 2):
        for digits in foil.DRAG:
            name = f"foil NACA 00{digits} at rest, {chord} cells"
            jobs[name] = partial(pitching, chord, digits / 100, wall, device, lengths=short)
        for k in (0.0, *foil.FREQUENCIES):
            name = f"foil NACA 0012 without friction, k {k:g}, {chord} cells"
            jobs[name] = partial(pitching, chord, 0.12, bare, device, k=k, lengths=short)
    return jobs


def main() -> None:
    """Run the cases that OUT lacks, print and write."""
    tiny = (False, "seconds on a CPU: do the cases run?")
    parser = command_line(__doc__, "out", device="cpu", tiny=tiny)
    parser.add_argument("--wall", choices=WALLS, default="ghost")
    parser.add_argument("--only", nargs="*", help="first words of the cases to run")
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
