"""The catalogue of effects: one file an effect, found by itself.

To add an effect of a servo, add a file to ``servo`` with its ``EFFECT`` (see ``effect.Effect``):
its equation and source in the docstring, its parameters, its term as a Warp function. To add one of
the body or the camera, add a file to ``body`` or ``camera`` (see ``body_effect``). Models, fits,
simulators, diagnoses and pages then know it.
"""

from __future__ import annotations

import importlib
import pkgutil
import zlib
from pathlib import Path
from typing import Any

from sim2real.effects.body_effect import BodyEffect, CameraEffect
from sim2real.effects.effect import Effect, Parameter
from sim2real.errors import InputError
from sim2real.warp_start import start_warp

start_warp()

MOST_EFFECTS = 62
"""Effects of servos that a simulation can tell apart: bits of the mask of those that are on."""


def _found(kind: str) -> list[Any]:
    package = importlib.import_module(f"{__name__}.{kind}")
    names = sorted(module.name for module in pkgutil.iter_modules(package.__path__))
    return [importlib.import_module(f"{package.__name__}.{name}").EFFECT for name in names]


CATALOGUE: tuple[Effect, ...] = tuple(_found("servo"))
"""Effects of servos, their supply and their link."""
if len(CATALOGUE) > MOST_EFFECTS:
    raise InputError(
        "sim2real/effects/servo", "", f"{len(CATALOGUE)} effects", f"at most {MOST_EFFECTS}"
    )

BODY: tuple[BodyEffect, ...] = tuple(sorted(_found("body"), key=lambda effect: effect.order))
"""Effects of the body in the water."""

CAMERA: tuple[CameraEffect, ...] = tuple(sorted(_found("camera"), key=lambda one: one.order))
"""Effects of the camera, in the order in which they act."""

SIGNATURE: int = 0x7FFFFFFF & zlib.crc32(
    b"".join(path.read_bytes() for path in sorted(Path(__path__[0]).rglob("*.py")))
)
"""Changes with any effect's source; a kernel that names it is compiled anew then."""

__all__ = [
    "BODY",
    "CAMERA",
    "CATALOGUE",
    "SIGNATURE",
    "BodyEffect",
    "CameraEffect",
    "Effect",
    "Parameter",
    "named",
]


def named(name: str, where: str = "effects") -> Effect:
    """The effect of servos with this identifier.

    Raises:
        InputError: If the catalogue has none; ``where`` says who asked for it.
    """
    for effect in CATALOGUE:
        if effect.name == name:
            return effect
    known = ", ".join(effect.name for effect in CATALOGUE)
    raise InputError(where, "effects", repr(name), f"one of {known}")


SET_ANEW = {
    "kp_Nm_per_rad": "another gain of the servo",
    "kd_Nms_per_rad": "another damping of the servo",
    "latency_s": "another latency of the servo",
}
"""Parameters of the plain servo in plain words, where they have changed."""


def plain(name: str) -> str:
    """Any effect in plain words, to stand in a sentence; its identifier's own if it is new."""
    known: dict[str, str] = {e.name: e.plain for e in (*CATALOGUE, *BODY, *CAMERA)}
    return (known | SET_ANEW).get(name, name.replace("_", " "))
