"""Swims to develop the diagnosis of pools on: other worlds than ``datasets/pool`` has.

    python benchmarks/pool_development.py OUT [--device cpu] [--cell-m 0.025] [--seconds 30]

The generator is that of ``datasets/pool``, which shares no law with the library; the worlds, the
seed, the cells and the box are others. About 25 minutes on one core.
"""

from __future__ import annotations

import importlib
import sys
from functools import partial
from pathlib import Path
from typing import Any

MAKE = Path(__file__).parents[1] / "datasets/pool/make.py"
SEED = 4711
BOX_M = (1.1, 0.7, 0.36)

WORLDS: dict[str, tuple[dict[str, dict[str, float]], float]] = {
    "a": ({}, 1.0),
    "b": ({}, 1.08),
    "c": ({}, 0.94),
    "d1": ({"tether": {"stiffness_N_per_m": 0.15, "x_m": -0.5, "y_m": -0.6}}, 1.0),
    "d2": ({"surface_friction.rubber": {"coefficient": 0.04}}, 1.0),
    "d3": ({"camera_rotation": {"angle_rad": -0.08}}, 1.0),
    "d4": ({"pool_current": {"u_m_s": -0.02, "v_m_s": 0.025}}, 1.0),
    "d5": ({"camera_latency": {"latency_s": 0.08}}, 1.0),
    "d6": (
        {
            "trim_asymmetry": {"offset_rad": -0.06},
            "skin_viscoelasticity": {"stiffness_Nm_per_rad": 0.6, "relaxation_s": 0.5},
        },
        1.0,
    ),
    "d7": (
        {
            "skin_elasticity": {"stiffness_Nm_per_rad": 0.4},
            "tether": {"stiffness_N_per_m": 0.3, "x_m": 0.6, "y_m": -0.5},
        },
        1.0,
    ),
    "d8": (
        {
            "pool_current": {"u_m_s": 0.025, "v_m_s": 0.03},
            "camera_rotation": {"angle_rad": 0.1},
        },
        1.0,
    ),
    "d9": (
        {
            "surface_friction.rubber": {"coefficient": 0.08},
            "camera_latency": {"latency_s": 0.06},
        },
        1.0,
    ),
}
"""What is concealed, and the factor on the gains of the servos, of each world."""


def generator() -> Any:  # noqa: ANN401 - a script, loaded as a module
    """``datasets/pool/make.py`` with these worlds."""
    sys.path.insert(0, str(MAKE.parent))
    make, world = (importlib.import_module(name) for name in ("make", "world"))
    plain = make.Truth("plain")
    make.WORLDS = tuple(
        make.Truth(
            name,
            effects,
            kp=tuple(factor * kp for kp in plain.kp),
            kd=tuple(kd / factor for kd in plain.kd),
            latency=tuple(factor * late for late in plain.latency),
        )
        for name, (effects, factor) in WORLDS.items()
    )
    world.Swimmer = partial(world.Swimmer, box_m=BOX_M)
    return make


if __name__ == "__main__":
    sys.argv += ["--seed", str(SEED)] if "--seed" not in sys.argv else []
    sys.argv += ["--cell-m", "0.025"] if "--cell-m" not in sys.argv else []
    generator().main()
