"""Simulate a fitted model on commands, from rest."""

from __future__ import annotations

from collections.abc import Mapping

from sim2real.arrays import Array
from sim2real.errors import InputError
from sim2real.model import Model
from sim2real.recording import Load
from sim2real.servo.parameters import joint_row


def predict(
    model: Model,
    t: Array,
    command: Mapping[str, Array],
    loads: Mapping[str, Load] | None = None,
    *,
    where: str = "commands",
) -> dict[str, Array]:
    """Measured angles predicted by the model.

    Args:
        model: The fitted model.
        t: Times in s, shape (T,).
        command: Set-points in rad by joint, each of shape (T,).
        loads: Loads by joint; for other joints, the load in the model.
        where: Origin of the commands, for messages.

    Returns:
        Angles in rad by joint, each of shape (T,).

    Raises:
        InputError: If a joint is not in the model.
    """
    from sim2real.servo.rollout import rollout

    angles = {}
    for joint, sent in command.items():
        if joint not in model.joints:
            modelled = ", ".join(model.joints)
            raise InputError(where, f"{joint}.command_rad", f"joint {joint}", f"one of {modelled}")
        row = joint_row(model.joints[joint], (loads or {}).get(joint), where=f"model, {joint}")
        angles[joint] = rollout(row[None], t, sent)[0]
    return angles
