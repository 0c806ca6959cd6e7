"""sim2real: make a robot's simulator tell the truth.

The names below are all that most programs need; each is loaded when it is first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
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
    from sim2real.servo.identify import identify as identify
    from sim2real.servo.predict import predict as predict

_HOMES = {
    "InputError": "errors",
    "Model": "model",
    "Recording": "recording",
    "Robot": "robot",
    "check": "check",
    "identify": "servo.identify",
    "predict": "servo.predict",
    "read_model": "model",
    "read_recording": "recording",
    "read_robot": "robot",
    "write_model": "model",
    "write_recording": "recording",
}

__all__ = sorted(_HOMES)


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'sim2real' has no attribute {name!r}")
    return getattr(importlib.import_module(f"sim2real.{_HOMES[name]}"), name)
