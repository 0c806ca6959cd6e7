"""``sim2real predict``."""

from __future__ import annotations

import argparse

from sim2real import verbs
from sim2real.errors import InputError
from sim2real.output import check_writable
from sim2real.recording import read_commands, write_recording


def run(options: argparse.Namespace) -> int:
    """Write the commands with the predicted angles as a recording."""
    check_writable(options.out)
    if options.out.resolve() == options.commands.resolve():
        raise InputError(options.out, "--out", "the file of the commands", "another file")
    model = verbs.model_of(options.model)
    commands = read_commands(options.commands)
    prediction = verbs.predict(commands, None, model)
    source = f"Simulated, not measured: {options.model.name} on {options.commands.name}."
    write_recording(prediction.recording(source=source), options.out)
    print(f"{options.out}: {commands.t.size} rows, {len(commands.joints)} joints")
    return 0
