"""Swimmers with prescribed motion: a robot under a wave, an eel, a foil that pitches."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.special import hankel2

from benchmarks.validation.case import CPU, Case, Figure, Where, chain, neutral, prescribed
from benchmarks.validation.slender import SMOOTH
from sim.lattice.velocities import D2Q9, WATER_KG_M3, Units
from sim.robot.bodies import HELD, KINEMATIC, Bodies
from sim.robot.shape import Hull
from sim2real.arrays import Array

RADII = (0.085, 0.115, 0.06, 0.025, 0.01)
"""Half-widths at the nose, the joints and the tail's tip, in body lengths."""
AMPLITUDE, LAG = np.array([0.45, 0.60, 0.75]), 1.2 * np.arange(3)
"""Of the wave, in rad."""
REYNOLDS = 1000.0
"""Body length times body length a cycle, over the viscosity."""
_COUNTED = 3


Gait = Callable[[float], Array]
"""Joint angles in rad at a time in cycles."""


def wave(t: float, ahead: float = 1.0) -> Array:
    """A wave of three joints that grows over the first cycle; towards the head if -1."""
    return np.asarray(min(1.0, t) * AMPLITUDE * np.sin(2 * np.pi * t - ahead * LAG))


def advance(path: Array) -> Array:
    """Body lengths a cycle along the mean heading over the last cycles of ``swim``, shape (E,)."""
    last = path[-1 - _COUNTED :]
    heading = last[:, :, 2].mean(axis=0)
    moved = (last[-1] - last[0])[:, :2] / _COUNTED
    return np.asarray(moved[:, 0] * np.cos(heading) + moved[:, 1] * np.sin(heading))


def swim(
    gaits: Sequence[Gait],
    cells: int,
    *,
    box: tuple[float, float],
    steps: int,
    cycles: int,
    radii: Sequence[float] | Array = RADII,
    reynolds: float = REYNOLDS,
    where: Where = CPU,
) -> Array:
    """x, y and heading each cycle (T, E, 3), in body lengths, of robots with prescribed joints.

    Args:
        gaits: One for each robot.
        cells: Cells a body length.
        box: Sides of a box of still water for each, in body lengths.
        steps: Steps per cycle.
        cycles: Number of cycles.
        radii: Half-widths at nose, joints and tip in body lengths.
        reynolds: Reynolds number.
        where: Device of the fluid.
    """
    cell, r = 1.0 / cells, np.asarray(radii)
    links = r.size - 1
    hull = chain(np.full(links, (1 - r[0] - r[-1]) / links), r)
    units = Units(cell, 1.0 / steps, 1.0, 1000.0)
    size = round(box[0] * cells), round(box[1] * cells)
    viscosity = units.viscosity_lu(1.0) / reynolds
    fluid = where.fluid(D2Q9, size, boxes=len(gaits), viscosity=viscosity, smagorinsky=0.1)
    masses = neutral(hull, cell, units, flat=True)
    bodies = Bodies(fluid, hull, masses, units)
    start = np.zeros((len(gaits), 2 + links))
    ahead = hull.length.sum() / 2 - masses.com[0]
    for axis, side in enumerate(size):  # between cells, about which the grid is symmetric
        start[:, axis] = (side // 2 - 0.5) * cell + ahead * np.cos(start[:, 2] - axis * np.pi / 2)
    start[:, 3:] = [gait(0.0) for gait in gaits]
    bodies.place(start)
    way, before, rates = [start[:, :3]], start[:, 3:], np.zeros_like(start)
    for step in range(cycles * steps):
        after = np.array([gait((step + 1) / steps) for gait in gaits])
        rates[:, 3:] = (after - before) * steps
        before = after
        bodies.prescribe(rates)
        bodies.step(KINEMATIC)
        if (step + 1) % steps == 0:
            way.append(bodies.motion.q.numpy()[:, :3].copy())
    return np.array(way)


EEL_SPEED, EEL_VISCOSITY, EEL_LINKS = 0.54, 1.4e-4, 14
"""Body lengths a cycle; body lengths squared a cycle."""
_NOSE, _TIP, _TAIL = 0.04, 0.01, 0.95
_EEL_STEPS, _EEL_BOX = 15, (6.0, 3.0)
"""Steps of a cycle for each cell of a body length: the tip moves 0.06 cells a step."""
_ALONG = np.linspace(_NOSE, 1 - _TIP, EEL_LINKS + 1)


def eel(t: float) -> Array:
    """Joint angles in rad of Carling's midline at t cycles; the wave grows over the first."""
    y = 0.125 * (_ALONG + 0.03125) / 1.03125 * np.sin(2 * np.pi * (_ALONG - t))
    growth = np.sin(np.pi / 2 * min(1.0, t))
    return np.asarray(np.diff(np.arcsin(-growth * np.diff(y) / (_ALONG[1] - _ALONG[0]))))


def anguilliform(where: Where = CPU) -> Case:
    """An eel that propels itself; up to 96 cells a body length on a CPU, 384 on a GPU.

    The boundary layer of this eel is one cell thick at 96 cells, where the speed still increases
    with resolution; only the result on a GPU has a bar.
    """
    sizes = (32,) if where.quick else ((96, 192, 384) if where.gpu else (48, 96))
    taper = _NOSE - (_NOSE - _TIP) * (_ALONG - _NOSE) / (_TAIL - _NOSE)
    shape: dict[str, Any] = {"radii": np.maximum(taper, _TIP), "reynolds": 1 / EEL_VISCOSITY}
    figures = []
    for cells in sizes:
        cycles, steps = 4 if where.quick else 8, _EEL_STEPS * cells
        length = {"box": _EEL_BOX, "steps": steps, "cycles": cycles}
        path = swim([eel], cells, where=where, **length, **shape)
        speed = np.linalg.norm((path[-1] - path[-1 - _COUNTED])[0, :2]) / _COUNTED
        bar = 0.1 if where.gpu and cells == sizes[-1] else None
        name = f"speed at {cells} cells a body length, body lengths a cycle"
        figures.append(Figure(name, float(speed), EEL_SPEED, bar))
    return Case(
        "Self-propelled anguilliform swimmer, Re 5609",
        "Kern and Koumoutsakos, J. Exp. Biol. 209 (2006) 4841, two-dimensional case; Re of the "
        "tail's tip as in Bhalla et al., J. Comput. Phys. 250 (2013) 446; midline: Carling, "
        "Williams, Bowtell, J. Exp. Biol. 201 (1998) 3143",
        f"{EEL_LINKS} links with prescribed joints, density ratio 1, {_EEL_STEPS} steps a cycle "
        f"for each cell, periodic, {_EEL_BOX[0]:g} x {_EEL_BOX[1]:g} body lengths",
        figures,
    )


CHORD_M, PITCH_RAD = 0.4, 0.14
FREQUENCIES = (2.0, 3.0, 4.0)
"""Reduced: pi f c / U."""
BARS = {48: 0.3, 96: 0.15}
"""Of the thrust, by the cells along the chord."""
_PANELS, _PITCHED, _PIVOT = 8, 0.04, 0.25
"""Links; towing speed in cells per step; place of the pivot from the nose, of the chord."""


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
    ends = nose + (0.995 - nose) * (0.5 - 0.5 * np.cos(np.linspace(0, np.pi, _PANELS + 1)))
    width = np.stack([half(ends[:-1]), half((ends[:-1] + ends[1:]) / 2), half(ends[1:])], axis=1)
    width[0, 0] = nose * chord
    return Hull(np.diff(ends) * chord, width, np.full_like(width, 1e6)), nose * chord


def coefficients(
    chord: int,
    *,
    k: float = 0.0,
    pitch_rad: float = PITCH_RAD,
    lengths: float = 6.0,
    where: Where = CPU,
) -> tuple[float, float]:
    """Coefficients of drag and of pitching power on the chord of a towed NACA 0012.

    Args:
        chord: Cells along the chord.
        k: Reduced frequency of the pitching about a quarter of the chord; at rest if 0.
        pitch_rad: Its amplitude.
        lengths: Chords that it is towed, whole periods; the second half is evaluated.
        where: Device of the fluid.
    """
    units = Units(CHORD_M / chord, _PITCHED / chord, CHORD_M / chord)  # in water
    cells = (round((lengths + 3) * chord), 4 * chord)
    fluid = where.fluid(D2Q9, cells, viscosity=3e-4, smagorinsky=0.17)
    hull, nose = section(CHORD_M, 0.12)
    steps = round(lengths * chord / _PITCHED)
    counted, omega = steps // 2, 2 * k * _PITCHED / chord
    if k:  # whole periods in the second half
        period = 2 * np.pi / omega
        steps = round(max(2, round(steps / period)) * period)
        counted = steps - round(max(1, steps // 2 // round(period)) * period)
    at = path(steps, chord, omega, cells, nose / units.cell_m, pitch_rad)
    at *= [units.cell_m, units.cell_m, 1.0]
    start, rates = np.zeros((1, 2 + hull.length.size)), np.zeros(2 + hull.length.size)
    start[0, :3] = at[0]
    bodies = prescribed(fluid, hull, start, units, wall=SMOOTH)
    found = np.zeros((steps, 2))
    for n in range(steps):
        rates[:3] = (at[n + 1] - at[n]) / units.step_s
        bodies.prescribe(rates)
        bodies.step(HELD)
        if n >= counted:
            force, twist = bodies.motion.force.numpy()[0], bodies.motion.twist.numpy()[0]
            found[n] = -force[:, 0].sum(), -(force * twist).sum()
    speed = _PITCHED * units.speed_m_s
    unit = 0.5 * WATER_KG_M3 * speed**2 * CHORD_M * units.depth_m
    resisted, power = found[counted:].mean(axis=0) / [unit, unit * speed]
    if fluid.stopped.numpy()[0] >= 0:  # the flow broke down
        resisted = power = np.nan
    return float(resisted), float(power - resisted)


def path(
    steps: int, chord: int, omega: float, cells: tuple[int, int], nose: float, pitch_rad: float
) -> Array:
    """Front end of the axis in cells, and heading, before each step and at the end: (steps + 1, 3).

    The speed grows over 0.3 chords, pitching over 0.5; ``nose`` is the nose's radius in cells.
    """
    t = np.arange(steps + 1)
    angle = pitch_rad * np.sin(omega * t) * np.minimum(1.0, t / (0.5 * chord / _PITCHED))
    moved = np.cumsum(_PITCHED * np.minimum(1.0, (t[1:] - 0.5) / (0.3 * chord / _PITCHED)))
    pivot = cells[0] - 1.3 * chord + np.append(0.0, moved)
    ahead = _PIVOT * chord - nose
    return np.stack(
        [pivot + ahead * np.cos(angle), cells[1] / 2 + 0.2 + ahead * np.sin(angle), angle], axis=1
    )


def foil(where: Where = CPU) -> Case:
    """16 cells of chord on a CPU, 48 and 96 on a GPU, where they have bars.

    The thrust is the drag without friction at rest, which ideal fluid has not, less that of the
    foil that pitches.
    """
    chords = (48, 96) if where.gpu else (16,)
    chords, lengths = ((12,), 1.0) if where.quick else (chords, 6.0)
    figures = []
    for chord in chords:
        more, label = {"lengths": lengths, "where": where}, f"{chord} cells"
        rest, _ = coefficients(chord, **more)
        for k in FREQUENCIES:
            thrust, needed = garrick(k)
            resisted, power = coefficients(chord, k=k, **more)
            ours, bar = rest - resisted, BARS.get(chord)
            figures += [
                Figure(f"thrust coefficient at k {k:g}, {label}", ours, thrust, bar),
                Figure(f"power coefficient at k {k:g}, {label}", power, needed),
            ]
    return Case(
        "A NACA foil that pitches by 0.14 rad",
        "Garrick, NACA Report 567 (1936): ideal fluid. Sections: Abbott and von Doenhoff, Theory "
        "of Wing Sections (1959)",
        f"D2Q9, towed {lengths:g} chords at {_PITCHED:g} cells a step, 4 chords wide, pitching "
        "about a quarter of the chord at the reduced frequency k; whole periods of the second half",
        figures,
    )
