"""``sim2real predict``."""

from __future__ import annotations

import argparse
from pathlib import Path

from sim2real import verbs
from sim2real.commands.views import check_views, write_views
from sim2real.output import check_writable
from sim2real.recording import read_commands, write_recording
from sim2real.servo.prediction import Prediction
from sim2real.viewers.scenes import with_prediction
from sim2real.viewers.signal_group import Scene


def run(options: argparse.Namespace) -> int:
    """Write the commands with the predicted angles as a recording."""
    check_writable(options.out)
    check_views(options)
    model = verbs.model_of(options.model)
    commands = read_commands(options.commands)
    prediction = verbs.predict(commands, None, model)
    source = f"Simulated, not measured: {options.model.name} on {options.commands.name}."
    write_recording(prediction.recording(source=source), options.out)
    write_views(options, lambda: _scene(options.commands, prediction))
    print(f"{options.out}: {commands.t.size} rows, {len(commands.joints)} joints")
    return 0


def _scene(file: Path, prediction: Prediction) -> Scene:
    """The commands and the prediction, and what was measured if the file is a recording."""
    (shown,) = verbs.recordings_of(file, or_commands=True)
    columns = enumerate(prediction.recordings[0].joints)
    scenes = [with_prediction(shown, joint, prediction.angles[0][:, j]) for j, joint in columns]
    return sum(scenes, start=Scene())
