"""Choice of the next recording: the swim in which the predictions of two rivals differ most."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from sim.inference.blocks import Blocks
from sim.inference.coordinates import signals_at
from sim.inference.swim_decision import Name
from sim.inference.twin_search import Fit, TwinSwims
from sim.robot.swimmer import CONTROL_S
from sim2real.arrays import Array
from sim2real.body import material_note
from sim2real.diagnose.result import Experiment

SECONDS = 12.0
_SIZE, _LAG = (0.28, 0.6), 1.1
CONTEXTS: Mapping[str, str] = {
    "skin": "with the torque off, joints turned by hand",
    "camera": "with a light that blinks with a joint's command in the picture",
    "drag": "coasting: a few strokes, then straight and still",
    "mass": "turning on the spot",
    "water": "the same strokes in two opposite headings",
}
"""Circumstances that distinguish a family of effects where no strokes do."""
_FAMILIES: Mapping[str, tuple[str, ...]] = {
    "skin": ("skin_elasticity", "skin_damping", "skin_viscoelasticity", "skin_coupling"),
    "camera": ("camera_latency", "pose_filter", "dropped_frames"),
    "drag": (
        "linear_drag",
        "form_drag",
        "surface_friction",
        "appendage_drag",
        "added_mass",
        "wall_effect",
    ),
    "mass": ("com_offset", "marker_offset", "trim_asymmetry"),
    "water": ("pool_current", "tether", "camera_rotation", "camera_scale"),
}


def _wave(
    beat: float, strong: float, turn: float = 0.0, until: float = SECONDS
) -> Callable[[Array, int], Array]:
    def sent(t: Array, joints: int) -> Array:
        size = strong * np.linspace(*_SIZE, joints)
        wave = size * np.sin(2 * np.pi * beat * t[:, None] - _LAG * np.arange(joints))
        ramp = np.clip(t / 0.8, 0, 1)[:, None] * (t[:, None] < until)
        return np.asarray(np.clip(ramp * (wave + turn), -0.76, 0.76))

    return sent


def _square(t: Array, joints: int) -> Array:
    return np.tile(0.4 * np.sign(np.sin(np.pi * t))[:, None], (1, joints))


MENU: Mapping[str, Callable[[Array, int], Array]] = {
    "slow, strong strokes": _wave(0.7, 1.1),
    "quick, weak strokes": _wave(1.5, 0.5),
    "strokes in a circle": _wave(1.0, 0.9, 0.25),
    "strokes, then coasting": _wave(1.2, 1.0, 0.0, 6.0),
    "squares in all joints": _square,
}
"""Swims that are compared; any robot can swim them."""


def next_swim(problem: TwinSwims, best: Fit, rival: Fit, effects: tuple[Name, Name]) -> Experiment:
    """The swim of ``MENU`` in which the predictions of two fits differ most.

    The difference is in standard deviations of the noise, including the twin's error.

    Args:
        problem: The swims that both were fitted to.
        best: The likeliest fit.
        rival: Its closest rival.
        effects: Their names and components.
    """
    before = problem.swims[0]
    t: Array = CONTROL_S * np.arange(round(SECONDS / CONTROL_S), dtype=np.float64)
    joints = before.command.shape[1]
    candidates = []
    for name, commands_of in MENU.items():
        command = commands_of(t, joints)
        empty = np.zeros((t.size, 3 + joints))
        swim = replace(before, t=t, command=command, signals=empty, pose=None, repeated=0.0)
        signals = signals_at(
            problem.coordinates, swim, np.stack([best.x, rival.x]), problem.simulate
        )
        blocks = Blocks.of(replace(swim, signals=signals[0]))
        errors = blocks.errors(signals[1]) * blocks.weights(problem.prior.shares)
        candidates.append((float(np.sqrt(np.sum(errors**2))), name, command))
    separation, name, command = max(candidates, key=lambda candidate: candidate[0])
    names = tuple(effect for effect, _ in effects)
    family = next((f for f, members in _FAMILIES.items() if set(names) <= set(members)), "")
    context = CONTEXTS.get(family, "none")
    also = f", and {context}" if family else ""
    titles = " and ".join(f"{n.replace('_', ' ')}{material_note(n, of)}" for n, of in effects)
    return Experiment(
        component="body",
        separates=names,
        command=name,
        context=context,
        separation=separation,
        duration_s=SECONDS,
        statement=(
            f"To distinguish {titles}, record {name}{also}: the predictions would differ by "
            f"{separation:.0f} standard deviations of the noise."
        ),
        t=t,
        signal=command,
    )


__all__ = ["next_swim"]
