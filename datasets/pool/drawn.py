"""Random robots, servos, waters, cameras, commands and concealed effects of the sealed swims."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from world import Water

from sim.robot.shape import hull_of
from sim2real.appendages import Appendage
from sim2real.model import JointModel, Model
from sim2real.robot import Joint, Link, Robot, Servo

Array = NDArray[np.float64]
Effects = dict[str, dict[str, float]]

SECONDS = 20.0
BODY = ("abs", "rubber")
BOX_M = (1.15, 0.8, 0.36)
LEAST_M = 0.014
WEAKEST, STRONGEST = 0.2, 3.0
"""Strengths of single effects, log-uniform between; of two, from ``WEAKEST_OF_TWO``."""
WEAKEST_OF_TWO = 0.6
AREA_SD = 0.1
"""Relative standard deviation of an appendage's drag area, as its file states."""
BENCH, BENCH_S = 0.12, 0.006
"""Largest errors of a bench: of gains, relative, and of latencies; uniform between."""


@dataclass(frozen=True)
class Drawn:
    """One robot in one pool: its cases share them.

    Attributes:
        robot: Links and joints.
        water: Parameters of the water.
        servos: True kp, kd, latency, each (J,).
        bench: Those that a bench identifies.
        areas: True drag areas of its appendages, relative to those that its file states.
    """

    robot: Robot
    water: Water
    servos: dict[str, tuple[float, ...]]
    bench: dict[str, tuple[float, ...]]
    areas: float = 1.0

    def model(self) -> Model:
        """The servos as a bench identifies them."""
        gains = zip(*(self.bench[name] for name in ("kp", "kd", "latency")), strict=True)
        return Model(
            joints={
                joint.name: JointModel(*of_joint, 0.002)
                for joint, of_joint in zip(self.robot.joints, gains, strict=True)
            }
        )


@dataclass(frozen=True)
class Case:
    """Concealed effects of one swim.

    Attributes:
        kind: ``null``, ``single``, ``double`` or ``outside``.
        effects: Identifier and parameters of each, as ``truth.Truth`` takes them.
        strength: Of each, by its identifier.
        referred: Whether the robot's swims in which nothing is missing come with it.
        camera: Noise: ``position_m``, ``heading_rad``.
    """

    kind: str
    effects: Effects
    strength: dict[str, float]
    referred: bool
    camera: dict[str, float] = field(default_factory=dict)


def robot_of(rng: np.random.Generator, name: str) -> Drawn:
    """A robot of two or three joints, 0.48 to 0.62 m long, and the pool that it swims in."""
    while True:
        J = int(rng.choice([2, 3, 3]))
        length = rng.uniform(0.48, 0.62)
        head = rng.uniform(0.34, 0.42)
        rest = rng.dirichlet(np.full(J, 40.0)) * (1 - head)
        share = np.concatenate([[head], rest])
        widest, highest = rng.uniform(0.2, 0.27) * length, rng.uniform(0.2, 0.26) * length
        middle = np.cumsum(share) - share / 2
        width = widest * np.clip(1.15 - 1.05 * middle, 0.12, 1.0) ** rng.uniform(1.0, 1.5)
        width[-1] = min(width[-1], 0.02 + 0.01 * rng.random())
        height = highest * np.clip(1.1 - 0.5 * middle, 0.4, 1.0)
        height[-1] = highest * rng.uniform(0.75, 1.0)
        lengths = share * length
        made = [BODY[0], *([BODY[1]] * (J - 1)), BODY[0] if rng.random() < 0.6 else BODY[1]]
        links = tuple(
            Link(
                name="head" if k == 0 else f"link{k}",
                mass_kg=1.0,
                length_m=float(np.round(lengths[k], 3)),
                width_m=float(np.round(width[k], 3)),
                height_m=float(np.round(height[k], 3)),
                material=made[k],
            )
            for k in range(J + 1)
        )
        servo = Servo("servo", 1.67, 5.24, 0.00419)
        joints = tuple(Joint(f"j{k + 1}", servo, (-0.8, 0.8)) for k in range(J))
        robot = Robot(name, links, joints)
        hull = hull_of(robot)
        if np.all(hull.length > 0.085) and hull.half_width.min() > 0.002:
            break
    volume = np.pi * (hull.half_width * hull.half_height).mean(axis=1) * hull.length
    volume *= rng.uniform(0.9, 0.97)
    weighed = tuple(
        replace(link, mass_kg=float(np.round(1000 * v, 3)))
        for link, v in zip(links, volume, strict=True)
    )
    head = replace(weighed[0], appendages=(bar(rng, weighed[0].length_m),))
    robot = Robot(name, (head, *weighed[1:]), joints)
    kp = rng.uniform(1.6, 2.6) * rng.uniform(0.9, 1.1, J)
    kd = rng.uniform(0.03, 0.037) * kp
    latency = rng.uniform(0.045, 0.08) + rng.uniform(-0.006, 0.006, J)
    true = {"kp": kp, "kd": kd, "latency": latency}
    off = {
        "kp": kp * (1 + rng.uniform(-BENCH, BENCH, J)),
        "kd": kd * (1 + rng.uniform(-BENCH, BENCH, J)),
        "latency": latency + rng.uniform(-BENCH_S, BENCH_S, J),
    }
    water = water_of(rng)
    plain, bench = (
        {name: tuple(float(x) for x in row) for name, row in one.items()} for one in (true, off)
    )
    return Drawn(robot, water, plain, bench, areas=float(1 + AREA_SD * rng.standard_normal()))


def water_of(rng: np.random.Generator) -> Water:
    """Water of a pool, the friction line of its walls and the edges of fins in it."""
    return Water(
        viscosity_m2_s=float(np.exp(rng.uniform(np.log(2e-5), np.log(8e-5)))),
        smagorinsky=float(rng.uniform(0.12, 0.16)),
        magic=float(rng.choice([1e-2, 5e-2])),
        line=str(rng.choice(["laminar", "turbulent"])),
        edge=float(rng.uniform(0.35, 0.65)),
        box_m=BOX_M,
    )


def bar(rng: np.random.Generator, length_m: float) -> Appendage:
    """A bar across the middle of the head, with a drag area of 20 to 60 cm2."""
    thick, coefficient = rng.uniform(0.015, 0.025), 0.9
    wide = rng.uniform(20e-4, 60e-4) / (coefficient * thick)
    size = (float(np.round(x, 3)) for x in (thick, wide, thick))
    return Appendage(
        name="bar", shape="cylinder", axis="across", size_m=tuple(size),  # type: ignore[arg-type]
        at_m=(float(np.round(length_m / 2, 3)), 0.0, 0.0), submerged=1.0,
        drag=(coefficient, coefficient * AREA_SD),
    )  # fmt: skip


def command_of(rng: np.random.Generator, J: int, period_s: float, seconds: float) -> Array:
    """Set-points in rad, shape (T, J): waves, straight and turning, of several speeds; a square."""
    t = period_s * np.arange(round(seconds / period_s))
    size = np.linspace(0.28, 0.62, J) if J > 1 else np.array([0.5])
    lag = rng.uniform(0.9, 1.3) * np.arange(J)
    cuts = np.sort(rng.uniform(0.15, 0.85, 3)) * seconds
    cuts = np.concatenate([[0.4], np.clip(cuts, 2.0, seconds - 2.0), [seconds]])
    square = int(rng.integers(0, 4))
    out, phase = np.zeros((t.size, J)), rng.uniform(0, 2 * np.pi)
    for k, (start, stop) in enumerate(zip(cuts[:-1], cuts[1:], strict=True)):
        here = (t >= start) & (t < stop)
        if k == square and stop - start > 2.0:
            low = 0.4 * np.sign(np.sin(2 * np.pi * rng.uniform(0.4, 0.7) * (t - start)))
            moved = rng.random(J) < 0.7
            out[here] = np.where(moved, low[here, None], 0.0)
            continue
        beat, strong = rng.uniform(0.7, 1.4), rng.uniform(0.6, 1.1)
        turn = rng.choice([0.0, -0.25, 0.25]) * rng.uniform(0.6, 1.2)
        wave = strong * size * np.sin(2 * np.pi * beat * (t[:, None] - start) - lag + phase)
        soft = np.clip((t - start) / 0.8, 0.0, 1.0)[:, None]
        out[here] = (soft * (wave + turn))[here]
    return np.clip(out, -0.76, 0.76)


def _one(name: str, size: float) -> Callable[[np.random.Generator, float], dict[str, float]]:
    return lambda rng, s: {name: size * s}


def _signed(name: str, size: float) -> Callable[[np.random.Generator, float], dict[str, float]]:
    return lambda rng, s: {name: float(rng.choice([-1, 1])) * size * s}


def _round(
    names: tuple[str, str], size: float, ratio: float = 1.0
) -> Callable[[np.random.Generator, float], dict[str, float]]:
    def draw(rng: np.random.Generator, s: float) -> dict[str, float]:
        angle = rng.uniform(0, 2 * np.pi)
        return {names[0]: size * s * np.cos(angle), names[1]: ratio * size * s * np.sin(angle)}

    return draw


def _tether(rng: np.random.Generator, s: float) -> dict[str, float]:
    far, angle = rng.uniform(0.3, 1.2), rng.uniform(0, 2 * np.pi)
    return {"stiffness_N_per_m": 0.12 * s, "x_m": far * np.cos(angle), "y_m": far * np.sin(angle)}


def _soft_skin(rng: np.random.Generator, s: float) -> dict[str, float]:
    return {"stiffness_Nm_per_rad": 0.5 * s, "relaxation_s": float(rng.uniform(0.15, 0.8))}


def _friction(rng: np.random.Generator, s: float) -> dict[str, float]:
    first, second = 0.08 * s * rng.dirichlet((1.0, 1.0))
    return {"j1.torque_Nm": first, "j2.torque_Nm": second}


NOMINAL: dict[str, Callable[[np.random.Generator, float], dict[str, float]]] = {
    "skin_elasticity": _one("stiffness_Nm_per_rad", 0.4),
    "skin_damping": _one("damping_Nms_per_rad", 0.015),
    "skin_viscoelasticity": _soft_skin,
    "skin_coupling": _one("stiffness_Nm_per_rad", 0.25),
    "linear_drag": _one("coefficient", 0.4),
    "surface_friction.abs": _one("coefficient", 0.02),
    "surface_friction.rubber": _one("coefficient", 0.03),
    "form_drag": _one("coefficient", 0.25),
    "added_mass": _one("ratio", 0.2),
    "pool_current": _round(("u_m_s", "v_m_s"), 0.025),
    "tether": _tether,
    "wall_effect": _one("ratio", 0.15),
    "com_offset": _round(("x_m", "y_m"), 0.004, 0.5),
    "trim_asymmetry": _signed("offset_rad", 0.035),
    "camera_latency": _one("latency_s", 0.05),
    "camera_rotation": _signed("angle_rad", 0.05),
    "camera_scale": _signed("ratio", 0.04),
    "marker_offset": _round(("x_m", "y_m"), 0.02),
    "pose_filter": _one("time_constant_s", 0.05),
    "dropped_frames": _one("probability", 0.08),
    "coulomb_friction": _friction,
}
"""Parameters of each effect at a strength."""


def _seiche(rng: np.random.Generator) -> dict[str, float]:
    angle = float(rng.choice([0, np.pi / 2]))
    speed, mode = rng.uniform(0.03, 0.07), float(rng.integers(1, 3))
    return {"speed_m_s": speed, "mode": mode, "direction_rad": angle}


def _drifting(rng: np.random.Generator) -> dict[str, float]:
    turn = float(rng.choice([-1, 1])) * rng.uniform(0.008, 0.025)
    angle, way = rng.uniform(0, 2 * np.pi), rng.uniform(0.004, 0.015)
    return {"rad_per_s": turn, "x_m_s": way * np.cos(angle), "y_m_s": way * np.sin(angle)}


def _swimmer(rng: np.random.Generator) -> dict[str, float]:
    first, second, third = np.sort(rng.uniform(3.0, SECONDS - 1.0, 3))
    return {
        "force_N": rng.uniform(0.12, 0.35), "moment_Nm": rng.uniform(0.01, 0.03),
        "beat_hz": rng.uniform(0.5, 1.6), "pass1_s": first, "pass2_s": second, "pass3_s": third,
    }  # fmt: skip


OUTSIDE: dict[str, Callable[[np.random.Generator], dict[str, float]]] = {
    "seiche": _seiche,
    "leaking_float": lambda rng: {
        "kg_per_s": rng.uniform(0.012, 0.035), "from_s": rng.uniform(2.0, 8.0),
    },
    "loose_fin": lambda rng: {
        "stiffness_Nm_per_rad": rng.uniform(0.03, 0.15), "from_s": rng.uniform(8.0, 12.0),
    },
    "drifting_mount": _drifting,
    "bending_marker": lambda rng: {
        "share": float(rng.choice([-1, 1])) * rng.uniform(0.15, 0.4),
        "arm_m": rng.uniform(0.03, 0.1),
    },
    "second_swimmer": _swimmer,
}  # fmt: skip
"""What no catalogue has."""
_SAME = ("skin", "camera_latency pose_filter dropped_frames", "surface_friction form_drag")


def plan(
    counts: dict[str, int], robots: int, rng: np.random.Generator, singles: Sequence[str] = ()
) -> list[list[tuple[str, str]]]:
    """Kind and name of each robot's cases; effects, or ``singles``, in turn, with equal shares."""
    effects = [str(n) for n in rng.permutation(singles or list(NOMINAL))]
    outsiders = [str(n) for n in rng.permutation(list(OUTSIDE))]
    cases = [("null", "")] * counts["null"]
    cases += [("single", effects[i % len(effects)]) for i in range(counts["single"])]
    cases += [("double", "")] * counts["double"]
    cases += [("outside", outsiders[i % len(outsiders)]) for i in range(counts["outside"])]
    mixed = [cases[i] for i in rng.permutation(len(cases))]
    return [mixed[k::robots] for k in range(robots)]


def case_of(kind: str, name: str, rng: np.random.Generator, robot: Robot) -> Case:
    """Draw what is concealed in a swim."""
    known = {f"surface_friction.{link.material}" for link in robot.links}
    names = [n for n in NOMINAL if not n.startswith("surface") or n in known]
    effects: Effects = {}
    strength: dict[str, float] = {}
    chosen = [name] if kind == "single" else []
    if kind == "double":
        while True:
            one, two = (names[i] for i in rng.choice(len(names), 2, replace=False))
            if not any(_family(one, s) and _family(two, s) for s in _SAME):
                break
        chosen = [one, two]
    least = WEAKEST if kind == "single" else WEAKEST_OF_TWO
    for each in chosen:
        s = float(np.exp(rng.uniform(np.log(least), np.log(STRONGEST))))
        effects[each], strength[each] = _plain(NOMINAL[each](rng, s)), s
    if kind == "outside":
        effects[name] = _plain(OUTSIDE[name](rng))
    camera = {
        "position_m": float(rng.uniform(0.001, 0.003)),
        "heading_rad": float(np.radians(rng.uniform(0.3, 0.8))),
    }
    return Case(kind, effects, strength, bool(rng.random() < 0.75), camera)


def _family(name: str, family: str) -> bool:
    return any(name.startswith(part) for part in family.split())


def _plain(values: dict[str, Any]) -> dict[str, float]:
    return {name: float(value) for name, value in values.items()}


def start_of(rng: np.random.Generator, case: Case) -> Array:
    """Where the head begins: x, y, heading; near a wall where that matters."""
    heading = rng.uniform(-np.pi, np.pi)
    if "wall_effect" in case.effects:
        return np.array([rng.uniform(-1.2, -0.4), rng.choice([-1.35, 1.35]), 0.0])
    return np.array([*rng.uniform(-0.6, 0.6, 2), heading])
