"""The verbs that a program calls, each in the same way: ``verb(recordings, robot, model)``.

Recordings, robots and models are values or the files they are in; one recording stands for a list
of one. What is random takes ``seed`` by keyword. What comes back is a frozen dataclass that prints
as a table and draws itself (``plot``, a Matplotlib figure). The verbs that need water
(``diagnose``, ``calibrate``, ``simulate``) are in ``sim.verbs``.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sim2real.arguments import check_whole
from sim2real.density import Density, normalised_density
from sim2real.errors import InputError
from sim2real.identification import identify as servos
from sim2real.model import Law, Model, read_model
from sim2real.plausible import validate_commands, validate_recording
from sim2real.posterior.check import Check
from sim2real.posterior.sample import JointSample, joint_sample, to_inference_data
from sim2real.posterior.servo import STEPS, WALKERS, ServoPosterior
from sim2real.ranges.gather import Gathered, Sampling, gather, sample_joints
from sim2real.recording import Recording, read_recording
from sim2real.robot import Robot, read_robot
from sim2real.servo.predict import predict as predict_angles
from sim2real.structured import shown

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
File = str | os.PathLike[str]
Recorded = Recording | File | Sequence[Recording | File]
"""Recordings as the verbs take them: values or files, one or many."""
_RECORDINGS = "a recording, its CSV file, or a list of these"


def identify(
    recordings: Recorded,
    robot: Robot | File,
    *,
    held_out: str | None = None,
    effects: str | Sequence[str] = (),
    law: Law | None = None,
    seed: int = 0,
) -> Model:
    """Identify the gains and the latency of every servo that moves.

    Args:
        recordings: Recordings of the servos; all of one joint are fitted together.
        robot: The robot that was recorded.
        held_out: Name of the recording to score on and not fit; the last one by default. Of a lone
            recording the last quarter is held out.
        effects: Names of effects, or one name, to fit together with the gains of every joint.
        law: ``"motor"``, a servo on its data sheet's line, or ``"pd"``, the linear one; by default
            the motor, and the linear one where there are ``effects`` or the data sheet states no
            torque and no speed.
        seed: Seed of the scan for a start.

    Raises:
        InputError: If no joint moves, a recording and the robot do not agree, or the catalogue
            lacks an effect.
    """
    given = recordings_of(recordings)
    return servos.identify(
        given, robot_of(robot), held_out=held_out, effects=effects, law=law, seed=seed
    )


def density(robot: Robot | File) -> Density:
    """Mass per length of each link over that of the robot; see ``normalised_density``."""
    return normalised_density(robot_of(robot))


@dataclass(frozen=True)
class Posterior:
    """Posteriors of a robot's servos.

    Attributes:
        joints: Of each joint that moved.
        checks: What each predicts of the recording held out, if there is one.
        seed: With which they were sampled.
    """

    joints: Mapping[str, ServoPosterior]
    checks: Mapping[str, Check]
    seed: int = 0

    def sample(self) -> JointSample:
        """Draws of all parameters of all joints, a row a draw, as ``posterior.npz`` keeps them."""
        return joint_sample(self.joints, np.random.default_rng(self.seed))

    def to_arviz(self) -> Any:  # noqa: ANN401 - ArviZ is not a dependency
        """ArviZ's ``InferenceData``: variables ``J.PARAMETER``, a chain a walker.

        Raises:
            ModuleNotFoundError: If the extra ``arviz`` is not installed.
        """
        return to_inference_data(self.joints)

    def __str__(self) -> str:
        """Median and 90 % interval of each parameter."""
        lines = []
        for joint, one in self.joints.items():
            rows = zip(one.priors.each, one.quantiles(0.05, 0.5, 0.95).T, strict=True)
            lines += [
                f"{joint}.{prior.name:30s} {middle:10.4g} {prior.unit:12s} "
                f"90 % {low:.4g} to {high:.4g}"
                for prior, (low, middle, high) in rows
            ]
        return "\n".join(lines) or "no joint moved on the bench"

    def plot(self, joint: str | None = None) -> Figure:
        """Marginals of one joint (the first by default), and of every two parameters.

        Raises:
            InputError: If that joint was not sampled.
        """
        from sim2real.report.corner_plot import corner_figure

        name = next(iter(self.joints), "") if joint is None else joint
        if name not in self.joints:
            raise InputError("plot", "joint", repr(name), f"one of {', '.join(self.joints)}")
        return corner_figure(self.joints[name], name)


def posterior(
    recordings: Recorded,
    robot: Robot | File,
    model: Model | File,
    *,
    held_out: str | None = None,
    steps: int = STEPS,
    walkers: int = WALKERS,
    seed: int = 0,
) -> Posterior:
    """Sample the posterior of each servo's gains, latency and effects.

    Args:
        recordings: Bench recordings.
        robot: The robot that was recorded.
        model: Its fitted servos; what effects they have is sampled too.
        held_out: Name of the recording to check on and not sample; the last one by default.
        steps: Steps of each chain.
        walkers: Walkers of each chain.
        seed: Of everything random.

    Raises:
        InputError: If recordings, robot and model do not agree, or a chain is too short to be
            believed.
    """
    _check_sampling("posterior", steps, walkers, seed)
    given, known = recordings_of(recordings), robot_of(robot)
    for recording in given:
        validate_recording(recording, known)
    bench = [recording for recording in given if recording.kind == "servo"]
    sampling = Sampling(steps=steps, walkers=walkers, seed=seed, held_out=held_out)
    return Posterior(*sample_joints(bench, model_of(model), sampling), seed)


def ranges(
    recordings: Recorded,
    robot: Robot | File,
    model: Model | File,
    *,
    held_out: str | None = None,
    steps: int = STEPS,
    walkers: int = WALKERS,
    seed: int = 0,
) -> Gathered:
    """Make randomization ranges; arguments as for ``posterior``, and swims count too.

    Returns:
        ``ranges`` (what ``write_ranges`` writes), and the posteriors, latencies and densities that
        they come from.
    """
    _check_sampling("ranges", steps, walkers, seed)
    sampling = Sampling(steps=steps, walkers=walkers, seed=seed, held_out=held_out)
    return gather(recordings_of(recordings), robot_of(robot), model_of(model), sampling)


def _check_sampling(call: str, steps: int, walkers: int, seed: int) -> None:
    check_whole(call, "steps", steps, 1)
    check_whole(call, "walkers", walkers, 2)
    check_whole(call, "seed", seed)


@dataclass(frozen=True)
class Prediction:
    """What a model makes of the commands of recordings.

    Attributes:
        recordings: The recordings, R of them.
        angles: Predicted angles in rad of each recording's joints, R arrays of shape (T, J).
    """

    recordings: tuple[Recording, ...]
    angles: tuple[Array, ...]

    @property
    def rmse(self) -> dict[tuple[str, str], float]:
        """Root mean square error in rad by recording and joint; NaN where nothing was measured."""
        out = {}
        for one, angles in zip(self.recordings, self.angles, strict=True):
            square = (angles - one.position) ** 2
            for j, joint in enumerate(one.joints):
                known = square[np.isfinite(square[:, j]), j]
                out[one.name, joint] = float(np.sqrt(known.mean())) if known.size else float("nan")
        return out

    def __str__(self) -> str:
        """The error of each joint in each recording."""
        return "\n".join(
            f"{name}, {joint}: {1e3 * error:.2f} mrad" for (name, joint), error in self.rmse.items()
        )

    def plot(self, recording: int = 0, joint: str | None = None) -> Figure:
        """Measured and predicted angles of one joint of one recording."""
        from sim2real.report.fit_plot import fit_figure

        one = self.recordings[recording]
        name = one.joints[0] if joint is None else joint
        return fit_figure(one, name, self.angles[recording][:, one.joints.index(name)])


def predict(recordings: Recorded, robot: Robot | File, model: Model | File) -> Prediction:
    """Simulate a model from rest on the commands of recordings.

    What was measured in them is not looked at. ``sim2real.servo.predict.predict`` does the same
    with arrays of commands.

    Raises:
        InputError: If recordings, robot and model do not agree.
    """
    given, known, fitted = recordings_of(recordings), robot_of(robot), model_of(model)
    angles = []
    for one in given:
        validate_commands(one, known)
        sent = {joint: one.command[:, j] for j, joint in enumerate(one.joints)}
        found = predict_angles(fitted, one.t, sent, one.loads, where=one.file)
        angles.append(np.stack([found[joint] for joint in one.joints], axis=1))
    return Prediction(tuple(given), tuple(angles))


def recordings_of(given: Recorded) -> list[Recording]:
    """Recordings, read where files are given.

    Raises:
        InputError: If there is none, or a file is no recording.
    """
    if not isinstance(given, Recording | str | os.PathLike | Iterable):
        raise InputError("recordings", "", shown(given), _RECORDINGS)
    several = [given] if isinstance(given, Recording | str | os.PathLike) else list(given)
    if not several:
        raise InputError("recordings", "", "none", "at least one")
    for one in several:
        if not isinstance(one, Recording | str | os.PathLike):
            raise InputError("recordings", "", shown(one), _RECORDINGS)
    return [one if isinstance(one, Recording) else read_recording(one) for one in several]


def robot_of(given: Robot | File) -> Robot:
    """The robot, read where a file is given.

    Raises:
        InputError: If it is neither, or the file is no robot.
    """
    if not isinstance(given, Robot | str | os.PathLike):
        raise InputError("robot", "", shown(given), "a robot or its robot.toml")
    return given if isinstance(given, Robot) else read_robot(given)


def model_of(given: Model | File) -> Model:
    """The model, read where a file is given.

    Raises:
        InputError: If it is neither, or the file is no model.
    """
    if not isinstance(given, Model | str | os.PathLike):
        raise InputError("model", "", shown(given), "a model or its MODEL.json")
    return given if isinstance(given, Model) else read_model(given)
