"""sim2real: identify servos, diagnose missing physics, generate randomization ranges.

The functions (verbs) have the same arguments, ``verb(recordings, robot, model)``; their results
print as tables and have a method ``plot()``. All names below are imported when first used.
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # isort: off
    from rl.verbs import forecast as forecast
    from sim.verbs import calibrate as calibrate, diagnose as diagnose, fit_twin as fit_twin
    from sim.verbs import design as design, simulate as simulate  # type: ignore[no-redef]
    from sim2real.errors import InputError as InputError
    from sim2real.exchange import export as export, import_log as import_log
    from sim2real.model import Model as Model, read_model as read_model, write_model as write_model
    from sim2real.recording import Recording as Recording, read_recording as read_recording
    from sim2real.recording import write_recording as write_recording
    from sim2real.robot import Robot as Robot, read_robot as read_robot
    from sim2real.verbs import check as check, density as density  # type: ignore[no-redef]
    from sim2real.verbs import identify as identify, latency as latency, posterior as posterior
    from sim2real.verbs import predict as predict, ranges as ranges, servos as servos
    from sim2real.version import __version__ as __version__
# isort: on

_NAMES = {
    "rl.verbs": "forecast",
    "sim.verbs": "calibrate design diagnose fit_twin simulate",
    "sim2real.errors": "InputError",
    "sim2real.exchange": "export import_log",
    "sim2real.model": "Model read_model write_model",
    "sim2real.recording": "Recording read_recording write_recording",
    "sim2real.robot": "Robot read_robot",
    "sim2real.verbs": "check density identify latency posterior predict ranges servos",
    "sim2real.version": "__version__",
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names.split()}
"""Module of each name. Six verbs need the fluid or policies, in the packages ``sim`` and ``rl``
above; they are imported when a program uses them. Besides the command line, only this module
imports upwards."""

__all__ = sorted(name for name in _HOMES if not name.startswith("_"))


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'sim2real' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(_HOMES)


class _Package(ModuleType):
    """This package, in which importing a subpackage does not replace the verb of the same name.

    Importing ``sim2real.ranges.entry`` would set ``sim2real.ranges`` to the subpackage; ``from
    sim2real.ranges.entry import ...`` does not need this, and the name remains that of the verb.
    """

    def __setattr__(self, name: str, value: object) -> None:
        if not (name in _HOMES and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package


def _register() -> None:
    """Register the environment where Gymnasium imports this module to find it."""
    if "gymnasium" in sys.modules:
        importlib.import_module("rl")


_register()
