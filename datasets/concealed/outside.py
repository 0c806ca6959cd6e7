"""Ten kinds of physics that no effect of the catalogue is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from bench import RECORDINGS, Servo
from excitation import DURATION_S
from world import Window, World

Parameters = dict[str, float]
NOISE_EDGE_S = 2.0  # windows keep this far from the ends


@dataclass(frozen=True)
class Outsider:
    """A kind of physics outside the catalogue.

    Attributes:
        driver: What decides its size from moment to moment.
        lasts_s: Shortest and longest window in s; None where it always acts, infinite where it
            stays to the end.
        draw: Parameters for a joint ``j`` of ``servos``.
        hide: Changes a world, whose windows of the joint are set already.
    """

    driver: str
    lasts_s: tuple[float, float] | None
    draw: Callable[[list[Servo], int, np.random.Generator], Parameters]
    hide: Callable[[World, int, Parameters], None]


def draw_windows(kind: Outsider, rng: np.random.Generator) -> dict[str, list[Window]]:
    """When it acts in each recording, s; in three of ten cases in only one of a and b."""
    windows: dict[str, list[Window]] = {name: [] for name in RECORDINGS}
    if kind.lasts_s is None:
        return windows
    spared = rng.choice(["a", "b"]) if rng.random() < 0.3 else ""
    for name in RECORDINGS:
        if name == spared:
            continue
        if np.isinf(kind.lasts_s[1]):
            windows[name] = [(round(float(rng.uniform(6, 22)), 3), DURATION_S)]
            continue
        count = int(rng.integers(1, 4))
        share = (DURATION_S - 2 * NOISE_EDGE_S) / count
        for k in range(count):
            length = min(float(rng.uniform(*kind.lasts_s)), 0.8 * share)
            start = NOISE_EDGE_S + k * share + rng.uniform(0, share - length)
            windows[name].append((round(float(start), 3), round(float(start + length), 3)))
    return windows


def _signed(rng: np.random.Generator, low: float, high: float) -> float:
    return float(rng.uniform(low, high) * rng.choice([-1.0, 1.0]))


def _fields(**constant: float) -> Callable[[World, int, Parameters], None]:
    """Parameters that are fields of the plant by the same name, with further constant ones."""

    def hide(world: World, j: int, p: Parameters) -> None:
        for name, value in {**p, **constant}.items():
            world.joints[name][j] = value

    return hide


def _slip(world: World, j: int, p: Parameters) -> None:
    if world.windows[j]:
        world.joints["slip_rad"][j] = p["slip_rad"]
        world.joints["slip_time_s"][j] = world.windows[j][0][0]


def _bend(world: World, j: int, p: Parameters) -> None:
    world.errors[j].update(p)


def _stick(world: World, j: int, _: Parameters) -> None:
    world.stuck.add(j)


def _draw_bend(_: list[Servo], __: int, rng: np.random.Generator) -> Parameters:
    if rng.random() < 0.4:
        return {"bend_per_rad": _signed(rng, 0.03, 0.1)}
    return {
        "bump_rad": float(rng.uniform(0.008, 0.025)),
        "bump_period_rad": float(rng.uniform(0.6, 1.0)),
        "bump_phase_rad": float(rng.uniform(0, 2 * np.pi)),
    }


def _draw_reaction(servos: list[Servo], j: int, rng: np.random.Generator) -> Parameters:
    other = int(rng.choice([k for k in range(len(servos)) if k != j]))
    inertia = servos[j].loads["a"].inertia_kgm2
    return {"neighbour": float(other), "reaction_kgm2": _signed(rng, 0.15, 0.7) * inertia}


OUTSIDERS: dict[str, Outsider] = {
    "horn_slip": Outsider(
        "time", (np.inf, np.inf),
        lambda s, j, rng: {"slip_rad": _signed(rng, 0.02, 0.12)},
        _slip,
    ),
    "brown_out": Outsider("time", (0.5, 4.0), lambda s, j, rng: {}, _fields(off_in_windows=1.0)),
    "jam": Outsider(
        "time", (1.0, 5.0),
        lambda s, j, rng: {"jam_Nm": float(s[j].kp * rng.uniform(0.02, 0.12))},
        _fields(bristle_rad=1e-3),
    ),
    "external_push": Outsider(
        "time", (1.0, 4.0),
        lambda s, j, rng: {"push_Nm": s[j].kp * _signed(rng, 0.01, 0.08)},
        _fields(),
    ),
    "vibration": Outsider(
        "time", None,
        lambda s, j, rng: {
            "shake_Nm": float(s[j].kp * rng.uniform(0.003, 0.02)),
            "shake_Hz": float(rng.uniform(1.5, 9.0)),
            "shake_phase": float(rng.uniform(0, 2 * np.pi)),
        },
        _fields(),
    ),
    "end_stop": Outsider(
        "position", None,
        lambda s, j, rng: {
            "stop_rad": float(rng.uniform(0.2, 0.4)),
            "stop_side": _signed(rng, 1.0, 1.0),
            "stop_Nm_per_rad": float(s[j].kp * rng.uniform(0.2, 2.0)),
        },
        _fields(),
    ),
    "gain_schedule": Outsider(
        "load", None,
        lambda s, j, rng: {
            "schedule_rad": float(rng.uniform(0.04, 0.2)),
            "schedule_factor": float(rng.choice([rng.uniform(0.4, 0.75), rng.uniform(1.3, 2.0)])),
        },
        _fields(),
    ),
    "potentiometer": Outsider("position", None, _draw_bend, _bend),
    "neighbour_reaction": Outsider("other_joint", None, _draw_reaction, _fields()),
    "stuck_sensor": Outsider("time", (0.4, 3.0), lambda s, j, rng: {}, _stick),
}  # fmt: skip
