"""``sim2real predict``."""

from __future__ import annotations

import argparse

import numpy as np

from sim2real.errors import InputError
from sim2real.model import read_model
from sim2real.output import check_writable
from sim2real.recording import Recording, read_commands, write_recording
from sim2real.servo.predict import predict


def run(options: argparse.Namespace) -> int:
    """Write the same rows with the predicted angles, as a recording."""
    check_writable(options.out)
    if options.out.resolve() == options.commands.resolve():
        raise InputError(options.out, "--out", "the file of the commands", "another file")
    model = read_model(options.model)
    commands = read_commands(options.commands)
    angles = predict(
        model, commands.t, commands.by_joint, commands.loads, where=str(options.commands)
    )
    joints = tuple(commands.by_joint)
    recording = Recording(
        name=options.out.stem,
        kind="servo",
        joints=joints,
        t=commands.t,
        command=np.stack([commands.by_joint[joint] for joint in joints], axis=1),
        position=np.stack([angles[joint] for joint in joints], axis=1),
        loads=commands.loads,
        source=f"Simulated, not measured: {options.model.name} on {options.commands.name}.",
    )
    write_recording(recording, options.out)
    print(f"{options.out}: {commands.t.size} rows, {len(joints)} joints")
    return 0
