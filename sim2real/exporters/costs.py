"""What a joint's motion loses in a target that is not made up for by a refit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from sim2real.arrays import Array
from sim2real.exporters.nearest import excitation
from sim2real.identification.search import errors_of
from sim2real.inference.least_squares import rms
from sim2real.model import Model
from sim2real.servo.parameters import COLUMNS, LINE, joint_row
from sim2real.servo.trace import Trace


@dataclass(frozen=True)
class Cost:
    """RMS difference from the exported model on standard steps, a chirp and a triangle."""

    joint: str
    what: str
    errors_rad: Mapping[str, float]  # by time step, or of all

    def __str__(self) -> str:
        """The differences in mrad."""
        errors = (f"{1e3 * error:.2f} mrad RMS{at}" for at, error in self.errors_rad.items())
        return f"{self.joint}: {self.what}: {', '.join(errors)}"


def costs(model: Model, *, whole_steps: bool, proportional: bool) -> tuple[Cost, ...]:
    """The cost of delays that are whole physics steps, and of a drive without damping of its own.

    That damping is then the motor's, and the no-load speed the stall torque over the damping.
    """
    found = []
    for name, joint in model.joints.items():
        data = excitation(joint, name)
        row = joint_row(joint, data[0].load, where=name)
        latency, damping, line = joint.latency_s, joint.kd_Nms_per_rad, COLUMNS.index(LINE[1])
        if whole_steps and latency > 0:
            steps = {f" at {1e3 * s:g} ms": s for s in (0.001, 0.002, 0.005)}
            errors = {at: _error(row, data, 2, round(latency / s) * s) for at, s in steps.items()}
            what = f"delay of {1e3 * latency:.1f} ms as whole physics steps"
            found.append(Cost(name, what, errors))
        stall = joint.motor.get("stall_torque_Nm", 0.0)
        if proportional and stall and row[line] and damping > 0:
            cost = _error(row, data, line, stall / damping)
            found.append(Cost(name, "damping of the drive added to the back-EMF", {"": cost}))
    return tuple(found)


def _error(row: Array, data: Sequence[Trace], column: int, value: float) -> float:
    changed = row.copy()
    changed[column] = value
    return rms(errors_of(changed, data))
