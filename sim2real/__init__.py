"""sim2real: make a robot's simulator tell the truth.

The verbs are called alike, ``verb(recordings, robot, model)``, and their results print as tables
and have ``plot()``. All names below are loaded when they are first used.
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sim.verbs import calibrate as calibrate
    from sim.verbs import diagnose as diagnose
    from sim.verbs import simulate as simulate
    from sim2real.check import check as check
    from sim2real.errors import InputError as InputError
    from sim2real.model import Model as Model
    from sim2real.model import read_model as read_model
    from sim2real.model import write_model as write_model
    from sim2real.recording import Recording as Recording
    from sim2real.recording import read_recording as read_recording
    from sim2real.recording import write_recording as write_recording
    from sim2real.robot import Robot as Robot
    from sim2real.robot import read_robot as read_robot
    from sim2real.verbs import density as density  # type: ignore[no-redef]
    from sim2real.verbs import identify as identify
    from sim2real.verbs import posterior as posterior
    from sim2real.verbs import predict as predict
    from sim2real.verbs import ranges as ranges
    from sim2real.version import __version__ as __version__

_HOMES = {
    "InputError": "sim2real.errors",
    "Model": "sim2real.model",
    "Recording": "sim2real.recording",
    "Robot": "sim2real.robot",
    "__version__": "sim2real.version",
    "calibrate": "sim.verbs",
    "check": "sim2real.check",
    "density": "sim2real.verbs",
    "diagnose": "sim.verbs",
    "identify": "sim2real.verbs",
    "posterior": "sim2real.verbs",
    "predict": "sim2real.verbs",
    "ranges": "sim2real.verbs",
    "read_model": "sim2real.model",
    "read_recording": "sim2real.recording",
    "read_robot": "sim2real.robot",
    "simulate": "sim.verbs",
    "write_model": "sim2real.model",
    "write_recording": "sim2real.recording",
}
"""Where each name lives. Three verbs need the water, a floor up, and are loaded from there only
when a program asks for them: beside the command line the one place that reaches up."""

__all__ = sorted(name for name in _HOMES if not name.startswith("_"))


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'sim2real' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})


class _Package(ModuleType):
    """This package: a verb is not hidden by the folder of the same name when that is imported.

    Importing ``sim2real.ranges.entry`` would make ``sim2real.ranges`` the folder; ``from
    sim2real.ranges.entry import ...`` does not need that, and the name stays the verb's.
    """

    def __setattr__(self, name: str, value: object) -> None:
        if not (name in _HOMES and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
