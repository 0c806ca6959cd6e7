"""Identification of the servos of an arm, whose joints load one another."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from sim2real.arm.arm_loads import predicted_arm, with_arm_loads
from sim2real.arm.description import Multibody
from sim2real.identification.identify import identify
from sim2real.inference.least_squares import rms
from sim2real.model import Model
from sim2real.recording import Recording
from sim2real.robot import Robot
from sim2real.servo.trace import split, traces


def identify_arm(
    recordings: Sequence[Recording],
    robot: Robot,
    *,
    rounds: int = 2,
    held_out: str | None = None,
    progress: Callable[[Sequence[str]], Sequence[str]] = lambda joints: joints,
    **options: Any,  # noqa: ANN401 - those of ``identify``
) -> Model:
    """Identify every servo of an arm under the load of the arm's motion.

    Each servo is fitted alone, under a known load: its inertia and torque follow from the URDF and
    the motion of all joints. In the first round that motion is the smoothed measured one, in later
    rounds what the fitted arm does, corrected by its slow error (``arm_loads``). ``progress`` is
    called in every round; ``options`` and errors are those of ``identify``.

    The held-out errors of the model are those of a coupled simulation, which uses no measured
    angle; ``heldout_given_load`` is the error of each servo under its known load.
    """
    assert robot.arm is not None
    model: Model | None = None
    for k in range(rounds + 1):
        loaded = with_arm_loads(recordings, robot, model)
        settings = {**options, "held_out": held_out, "refit": k == rounds}
        if k == rounds and model is not None:  # scored, and then fitted to all
            figures = _coupled_figures(model, recordings, held_out)
        fitted = identify(loaded, robot, progress=progress, **settings)
        model = replace(fitted, arm=robot.arm)
    assert model is not None
    return replace(model, fit=figures)


def _coupled_figures(
    model: Model, recordings: Sequence[Recording], held_out: str | None
) -> dict[str, Mapping[str, float | None]]:
    """The errors of the fit, those on held-out data from a coupled simulation."""
    scored = {joint: split(traces(recordings, joint), held_out)[1] for joint in model.joints}
    files = {trace.file for held in scored.values() for trace in held}
    assert model.arm is not None
    multibody = Multibody(model.arm)
    predicted = {
        recording.file: predicted_arm(multibody, model.joints, recording.t, recording.commands)[1]
        for recording in recordings
        if recording.file in files
    }
    fit = dict(model.fit)
    for joint, held in scored.items():
        errors = [
            (predicted[trace.file][joint][: trace.t.size] - trace.position)[trace.used]
            for trace in held
        ]
        signal = f"{joint}.position_rad"
        figures = dict(fit[signal])
        figures["heldout_given_load"] = figures.get("heldout")
        figures["heldout"] = rms(errors) if errors else None
        fit[signal] = figures
    return fit
