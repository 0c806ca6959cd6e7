"""The catalogue of effects: one file per effect, discovered automatically.

To add an effect of a servo, add a file to ``servo`` with its ``EFFECT`` (see ``effect.Effect``):
its equation and source in the docstring, its parameters, its term as a Warp function. To add one of
the body or the camera, add a file to ``body`` or ``camera`` (see ``body_effect``). Models, fits,
simulators, diagnoses and pages then support it.
"""

import importlib
import os
import pkgutil
import sys
import zlib
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import warp

from sim2real.effects.body_effect import BodyEffect, CameraEffect, SwimEffect
from sim2real.effects.effect import Effect as Effect
from sim2real.errors import InputError

warp.config.log_level = max(warp.config.log_level, warp.LOG_ERROR)


def start_warp() -> None:
    """Initialize Warp, discarding what its native code prints to standard error."""
    sys.stderr.flush()
    stderr_copy, null = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(null, 2)
        warp.init()  # type: ignore[no-untyped-call]
    finally:
        os.dup2(stderr_copy, 2)
        os.close(stderr_copy)
        os.close(null)


start_warp()

AnyEffect = TypeVar("AnyEffect", Effect, SwimEffect)

MOST_EFFECTS = 62
"""Largest number of servo effects: bits of the mask of active ones."""


def _discovered(kind: str) -> list[Any]:
    """The effects in a folder, with the names of their files."""
    package = importlib.import_module(f"{__name__}.{kind}")
    names = sorted(module.name for module in pkgutil.iter_modules(package.__path__))
    modules = (importlib.import_module(f"{package.__name__}.{name}") for name in names)
    return [replace(module.EFFECT, name=name) for name, module in zip(names, modules, strict=True)]


CATALOGUE: tuple[Effect, ...] = tuple(_discovered("servo"))
"""Effects of servos, their supply and their link."""
if len(CATALOGUE) > MOST_EFFECTS:
    raise InputError(
        "sim2real/effects/servo", "", f"{len(CATALOGUE)} effects", f"at most {MOST_EFFECTS}"
    )

BODY: tuple[BodyEffect, ...] = tuple(sorted(_discovered("body"), key=lambda effect: effect.order))
"""Effects of the body in the water."""

CAMERA: tuple[CameraEffect, ...] = tuple(sorted(_discovered("camera"), key=lambda e: e.order))
"""Effects of the camera, in the order in which they act."""

SIGNATURE: int = 0x7FFFFFFF & zlib.crc32(
    b"".join(path.read_bytes() for path in sorted(Path(__path__[0]).rglob("*.py")))
)
"""Hash of the sources of all effects; kernels that refer to it are recompiled when it changes."""


def named(name: str, where: str = "effects") -> Effect:
    """The effect of servos with this identifier, or an InputError about ``where``."""
    return find(CATALOGUE, name, where)


def find(effects: Iterable[AnyEffect], name: str, where: str) -> AnyEffect:
    """The one of these effects with this identifier, or an InputError about ``where``."""
    by_name = {effect.name: effect for effect in effects}
    if name not in by_name:
        raise InputError(where, "effects", repr(name), f"one of {', '.join(by_name)}")
    return by_name[name]


SET_ANEW = {
    "kp": "another gain of the servo",
    "kd": "another damping of the servo",
    "latency": "another latency of the servo",
    "stall_torque": "another stall torque of the motor",
    "no_load_speed": "another no-load speed of the motor",
    "load": "another load",
}
"""Parameters of a servo that may have changed since references, and descriptions for sentences."""


def plain(name: str) -> str:
    """Description of an effect for a sentence, from its identifier if it is not catalogued.

    That of a material is named ``effect.material``.
    """
    descriptions: dict[str, str] = {e.name: e.plain for e in (*CATALOGUE, *BODY, *CAMERA)}
    effect, _, material = name.partition(".")
    description = (descriptions | SET_ANEW).get(effect, effect.replace("_", " "))
    return f"{description} ({material})" if material else description
