"""NACA foils in two dimensions: the thrust of one that pitches, without friction, and drag at rest.

Sources: Garrick, NACA Report 567 (1936): thrust and power of a thin foil that pitches in ideal
fluid. Sheldahl and Klimas, SAND80-2114 (1981): drag of NACA 0012 and 0021 at zero incidence, at a
Reynolds number of 8e4 to 1.6e5. Sections: Abbott and von Doenhoff, Theory of Wing Sections (1959).
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np
from scipy.special import hankel2

from sim.cases.case import Case, Figure
from sim.cases.walls import WALLS
from sim.fluid.fluid import Fluid
from sim.fluid.wall import Wall
from sim.lattice.units import WATER_KG_M3, Units
from sim.lattice.velocities import D2Q9
from sim.robot.bodies import HELD, Bodies, Masses
from sim.robot.shape import Hull
from sim2real.arrays import Array

CHORD_M = 0.4
PITCH_RAD = 0.14
FREQUENCIES = (2.0, 3.0, 4.0)
"""Reduced: pi f c / U."""
DRAG = {12: 0.0103, 21: 0.0177}
"""Drag coefficients at rest, by the digits of the thickness in percent."""
BARS = {48: 0.3, 96: 0.15}
"""Of the thrust, by the cells along the chord."""
_LINKS = 8
_SPEED = 0.04
"""Towing speed in cells per step."""
_PIVOT = 0.25
"""Of the chord, from the nose."""


def garrick(k: float, pitch_rad: float = PITCH_RAD) -> tuple[float, float]:
    """Coefficients of thrust and power of a foil that pitches about a quarter of its chord.

    By Garrick's theory, with lift L and moment M by Theodorsen's function C(k), NACA Report 496
    (1935). Lengths are in half chords, times in half chords over the speed U, and a = -1/2 is the
    pivot's place. The suction at the nose is S = (2 C Q - dalpha/dt) / sqrt 2 with
    Q = alpha + (1/2 - a) dalpha/dt. Thrust is the mean of pi S^2 - alpha L, power that of
    -M dalpha/dt, and the coefficients are on the chord and rho U^2 / 2 (U^3).
    """
    a = 2 * _PIVOT - 1
    first, zeroth = hankel2(1, k), hankel2(0, k)
    theodorsen = first / (first + 1j * zeroth)
    alpha = pitch_rad
    rate = 1j * k * alpha
    growth = 1j * k * rate
    Q = alpha + (0.5 - a) * rate
    lift = np.pi * (rate - a * growth) + 2 * np.pi * theodorsen * Q
    still = (0.5 - a) * rate + (1 / 8 + a**2) * growth
    moment = np.pi * (2 * (a + 0.5) * theodorsen * Q - still)
    suction = (2 * theodorsen * Q - rate) / np.sqrt(2)
    thrust = 0.5 * (np.pi * abs(suction) ** 2 - alpha * lift.real)
    return float(thrust), float(-0.5 * (moment * np.conj(rate)).real)


def section(chord: float, thickness: float) -> tuple[Hull, float]:
    """A NACA section of four digits in metres, ``chord`` long, and the radius of its nose."""

    def half(x: Array) -> Array:
        series = np.array([0.2969, -0.126, -0.3516, 0.2843, -0.1036])
        powers = np.stack([np.sqrt(x), x, x**2, x**3, x**4])
        return np.asarray(5 * thickness * chord * (series @ powers))

    nose = 1.1019 * thickness**2
    ends = nose + (0.995 - nose) * (0.5 - 0.5 * np.cos(np.linspace(0, np.pi, _LINKS + 1)))
    width = np.stack([half(ends[:-1]), half((ends[:-1] + ends[1:]) / 2), half(ends[1:])], axis=1)
    width[0, 0] = nose * chord
    return Hull(np.diff(ends) * chord, width, np.full_like(width, 1e6)), nose * chord


def coefficients(
    chord: int,
    thickness: float,
    wall: Wall,
    *,
    k: float = 0.0,
    pitch_rad: float = PITCH_RAD,
    lengths: float = 6.0,
    device: str = "cpu",
    threads: int = 2,
) -> tuple[float, float]:
    """Coefficients of drag and of pitching power on the chord of a towed foil.

    Args:
        chord: Cells along the chord.
        thickness: Over the chord.
        wall: The wall model.
        k: Reduced frequency of the pitching about a quarter of the chord; at rest if 0.
        pitch_rad: Its amplitude.
        lengths: Chords that it is towed, whole periods; the second half is evaluated.
        device: Device of the fluid.
        threads: CPU threads of the fluid.
    """
    units = Units(CHORD_M / chord, _SPEED / chord, CHORD_M / chord)  # in water
    cells = (round((lengths + 3) * chord), 4 * chord)
    fluid = Fluid(D2Q9, cells, viscosity=3e-4, smagorinsky=0.17, device=device, threads=threads)
    hull, nose = section(CHORD_M, thickness)
    links = hull.length.size
    light = Masses(np.ones(links), np.ones(links), np.zeros(links))
    bodies = Bodies(fluid, hull, light, units, wall=wall)
    steps = round(lengths * chord / _SPEED)
    counted, omega = steps // 2, 2 * k * _SPEED / chord
    if k:  # whole periods in the second half
        period = 2 * np.pi / omega
        steps = round(max(2, round(steps / period)) * period)
        counted = steps - round(max(1, steps // 2 // round(period)) * period)
    at = path(steps, chord, omega, cells, nose / units.cell_m, pitch_rad)
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
    speed = _SPEED * units.speed_m_s
    unit = 0.5 * WATER_KG_M3 * speed**2 * CHORD_M * units.depth_m
    drag, power = found[counted:].mean(axis=0) / [unit, unit * speed]
    if fluid.stopped.numpy()[0] >= 0:  # the flow broke down
        drag = power = np.nan
    return float(drag), float(power - drag)


def path(
    steps: int, chord: int, omega: float, cells: tuple[int, int], nose: float, pitch_rad: float
) -> Array:
    """Front end of the axis in cells, and heading, before each step and at the end: (steps + 1, 3).

    The speed grows over 0.3 chords, pitching over 0.5; ``nose`` is the nose's radius in cells.
    """
    t = np.arange(steps + 1)
    angle = pitch_rad * np.sin(omega * t) * np.minimum(1.0, t / (0.5 * chord / _SPEED))
    moved = np.cumsum(_SPEED * np.minimum(1.0, (t[1:] - 0.5) / (0.3 * chord / _SPEED)))
    pivot = cells[0] - 1.3 * chord + np.append(0.0, moved)
    ahead = _PIVOT * chord - nose
    return np.stack(
        [pivot + ahead * np.cos(angle), cells[1] / 2 + 0.2 + ahead * np.sin(angle), angle], axis=1
    )


def run(*, device: str = "cpu", threads: int = 2, quick: bool = False) -> Case:
    """16 cells of chord on a CPU, 48 and 96 on a GPU, where ghost cells have bars.

    The thrust is the drag without friction at rest, which ideal fluid has not, less that of the
    foil that pitches. The drag at rest is with the turbulent friction line, and has no bar.
    """
    chords = (48, 96) if device.startswith("cuda") else (16,)
    chords, lengths = ((12,), 1.0) if quick else (chords, 6.0)
    figures = []
    for chord, name in product(chords, WALLS):
        measured = partial(coefficients, chord, lengths=lengths, device=device, threads=threads)
        wall, label = WALLS[name], f"{name}, {chord} cells"
        bar = BARS.get(chord) if wall.ghosts else None
        rest, _ = measured(0.12, wall)
        for k in FREQUENCIES:
            thrust, needed = garrick(k)
            drag, power = measured(0.12, wall, k=k)
            figures += [
                Figure(f"thrust coefficient at k {k:g}, {label}", rest - drag, thrust, bar),
                Figure(f"power coefficient at k {k:g}, {label}", power, needed),
            ]
        for digits, known in DRAG.items():
            drag, _ = measured(digits / 100, replace(wall, line="turbulent"))
            figures.append(Figure(f"drag of NACA 00{digits} at rest, {label}", drag, known))
    return Case(
        name="foil",
        title="NACA foils, pitching by 0.14 rad and at rest",
        source="Garrick, NACA Report 567 (1936); Sheldahl and Klimas, SAND80-2114 (1981)",
        setup=f"D2Q9, towed {lengths:g} chords at {_SPEED:g} cells a step, 4 chords wide, pitching "
        "about a quarter of the chord at the reduced frequency k; whole periods of the second half",
        figures=tuple(figures),
    )
