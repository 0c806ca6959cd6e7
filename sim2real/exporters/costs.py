"""What a joint's motion loses in a target that no refit makes up for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from sim2real.exporters.nearest import excitation
from sim2real.identification.search import errors_of
from sim2real.inference.least_squares import rms
from sim2real.model import Model
from sim2real.servo.parameters import COLUMNS, LINE, joint_row


@dataclass(frozen=True)
class Cost:
    """RMS differences from the exported model on standard steps, a chirp and a triangle."""

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
        data, latency, kd = excitation(joint, name), joint.latency_s, joint.kd_Nms_per_rad
        stall, changes = joint.motor.get("stall_torque_Nm", 0.0), {}
        if whole_steps and latency > 0:
            steps = {f" at {1e3 * s:g} ms": round(latency / s) * s for s in (0.001, 0.002, 0.005)}
            what = f"delay of {1e3 * latency:.1f} ms as whole physics steps"
            changes[what] = COLUMNS.index("latency_s"), steps
        if proportional and stall * joint.motor.get("no_load_speed_rad_s", 0.0) * kd > 0:
            what = "damping of the drive added to the back-EMF"
            changes[what] = COLUMNS.index(LINE[1]), {"": stall / kd}
        for what, (column, values) in changes.items():
            rows = {at: joint_row(joint, data[0].load, where=name) for at in values}
            for at, row in rows.items():
                row[column] = values[at]
            errors = {at: rms(errors_of(row, data)) for at, row in rows.items()}
            found.append(Cost(name, what, errors))
    return tuple(found)
