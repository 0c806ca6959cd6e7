"""The catalogue of effects: one file an effect, found by itself.

To add an effect, add a file here that defines ``EFFECT`` (see ``effect.Effect``): its equation and
source in the docstring, its parameters, its term as a Warp function. Rollouts, models and
predictions then know it.
"""

from __future__ import annotations

import importlib
import pkgutil
import zlib
from pathlib import Path

from sim2real.effects.effect import Effect, Parameter
from sim2real.errors import InputError
from sim2real.warp_start import start_warp

start_warp()

CATALOGUE: tuple[Effect, ...] = tuple(
    importlib.import_module(f"{__name__}.{module.name}").EFFECT
    for module in sorted(pkgutil.iter_modules(__path__), key=lambda module: module.name)
    if module.name != "effect"
)

SIGNATURE: int = 0x7FFFFFFF & zlib.crc32(
    b"".join(path.read_bytes() for path in sorted(Path(__path__[0]).glob("*.py")))
)
"""Changes with any effect's source; a kernel that names it is compiled anew then."""

__all__ = ["CATALOGUE", "SIGNATURE", "Effect", "Parameter", "named"]


def named(name: str, where: str = "effects") -> Effect:
    """The effect with this identifier.

    Raises:
        InputError: If the catalogue has none; ``where`` says who asked for it.
    """
    for effect in CATALOGUE:
        if effect.name == name:
            return effect
    known = ", ".join(effect.name for effect in CATALOGUE)
    raise InputError(where, "effects", repr(name), f"one of {known}")
