"""The functions (verbs) of the Python interface, called as ``verb(recordings, robot, model)``.

Recordings, robots and models are objects or the names of their files; a single recording is taken
as a list of one. The result is a frozen dataclass that prints as a table and has ``plot()``, which
returns a Matplotlib figure. The options of the commands of the same names are made from the
signatures and docstrings below, so this module imports no large libraries. The verbs that need the
fluid (``diagnose``, ``calibrate``, ``simulate``) are in ``sim.verbs``.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from sim2real.errors import InputError, check_positive, check_whole, shown

if TYPE_CHECKING:
    from sim2real.check import Checks
    from sim2real.model import Model
    from sim2real.posterior.posteriors import Posteriors
    from sim2real.ranges.gather import Gathered
    from sim2real.ranges.latency import LatencySplit
    from sim2real.recording import Recording
    from sim2real.robot import Density, Robot
    from sim2real.servo.prediction import Prediction
    from sim2real.servo_library.catalogue import ServoLibrary

    File = str | os.PathLike[str]
    Recorded = Recording | File | Sequence[Recording | File]
    Models = Sequence[Model | File] | Mapping[str, Sequence[Model | File]]


def check(recordings: Recorded, robot: Robot | File | None = None, *, seed: int = 0) -> Checks:
    """Check recordings, and state what they can identify.

    Args:
        recordings: Recordings (NAME.csv with NAME.json in the same folder).
        robot: The robot, to check limits and names as well (robot.toml).
        seed: Seed of the search for an approximate servo, which predicts the precision.

    Returns:
        The check of each recording, in their order.

    Raises:
        InputError: If the robot lacks a joint of a recording, or a unit or a column must be in
            error.
    """
    from tqdm import tqdm

    from sim2real.check import Checks
    from sim2real.check import check as checked

    description = None if robot is None else robot_of(robot)
    listed = tqdm(recordings_of(recordings), desc="check", unit="recording", disable=None)
    return Checks(checked(recording, description, seed=seed) for recording in listed)


def identify(
    recordings: Recorded,
    robot: Robot | File,
    *,
    held_out: str | None = None,
    effects: Sequence[str] | str = (),
    law: Literal["pd", "motor"] | None = None,
    effort: float = 1.0,
    interval: float = 0.9,
    seed: int = 0,
) -> Model:
    """Identify the gains and the latency of every servo that moves.

    The servos of an arm, whose robot.toml names a URDF, are identified under the load that its
    joints exert on one another.

    Args:
        recordings: Recordings of the servos (NAME.csv with NAME.json); all recordings of one joint
            are fitted together.
        robot: The robot that was recorded (robot.toml).
        held_out: Name of the recording to score on and not to fit; the last one by default, or the
            last quarter of a single recording.
        effects: Names of effects to fit together with the gains of every joint, such as
            load_friction or unmodelled_inertia.
        law: A motor (motor), whose torque has the limit that the recordings show: the torque-speed
            line of its data sheet, a flat limit, or both; or a linear servo (pd). By default motor,
            and pd where effects are given or the data sheet states neither torque nor speed.
        effort: Multiple of the largest number of evaluations of a search; a note states which fits
            have spent theirs.
        interval: Probability of the intervals of the parameters.
        seed: Seed of the search for a starting point.

    Returns:
        The fitted model, with intervals and held-out errors.

    Raises:
        InputError: If no joint moves, a recording and the robot do not agree, or the catalogue has
            no such effect.
    """
    from tqdm import tqdm

    from sim2real.arm.identify_arm import identify_arm
    from sim2real.identification.identify import identify as identify_servos

    check_positive("identify", "effort", effort)
    description, listed = robot_of(robot), recordings_to_fit(recordings)
    settings: dict[str, Any] = {"held_out": held_out, "law": law, "effort": effort}
    settings |= {"interval": interval, "seed": seed}
    settings["effects"] = (effects,) if isinstance(effects, str) else effects
    settings["progress"] = lambda joints: tqdm(joints, desc="identify", unit="joint", disable=None)
    fit = identify_servos if description.arm is None else identify_arm
    return fit(listed, description, **settings)


def density(robot: Robot | File) -> Density:
    """Compute the mass per length of each link relative to that of the robot.

    Args:
        robot: The robot, with masses and lengths of its links (robot.toml).
    """
    from sim2real.robot import normalised_density

    return normalised_density(robot_of(robot))


def posterior(
    recordings: Recorded,
    robot: Robot | File,
    model: Model | File,
    *,
    held_out: str | None = None,
    steps: int = 2000,
    walkers: int = 32,
    interval: float = 0.9,
    seed: int = 0,
) -> Posteriors:
    """Sample the posterior of each servo's gains, latency and effects.

    Args:
        recordings: Bench recordings.
        robot: The robot that was recorded.
        model: Its fitted servos; the effects that they have are sampled too.
        held_out: Name of the recording to check a fit to the others on; by default the last.
        steps: Most steps of each chain, which ends at 100 autocorrelation times.
        walkers: Walkers of each chain.
        interval: Probability of the intervals of the posterior.
        seed: Seed of the chains.

    Raises:
        InputError: If recordings, robot and model do not agree, or a chain is too short to have
            converged.
    """
    import warnings

    from sim2real.arm.arm_loads import with_arm_loads
    from sim2real.plausible import admitted
    from sim2real.posterior.posteriors import Posteriors
    from sim2real.ranges.gather import Sampling, sample_joints
    from sim2real.servo.trace import at_one_gain

    _check_sampling("posterior", steps, walkers, seed, interval)
    loaded, description = recordings_to_fit(recordings), robot_of(robot)
    loaded, sentences = admitted(loaded, description)
    for sentence in sentences:
        warnings.warn(sentence, stacklevel=2)
    fitted = model_of(model)
    bench = [recording for recording in loaded if recording.kind == "servo"]
    bench = at_one_gain(bench, fitted.firmware_p_gain)
    sampling = Sampling(steps, walkers, seed, held_out, level=interval)
    loaded = with_arm_loads(bench, description, fitted)
    return Posteriors(*sample_joints(loaded, description, fitted, sampling), seed)


def ranges(
    recordings: Recorded = (),
    robot: Robot | File | None = None,
    model: Model | File | None = None,
    *,
    population: Sequence[str] | Models = (),
    held_out: str | None = None,
    steps: int = 2000,
    walkers: int = 32,
    chains: File | None = None,
    interval: float = 0.9,
    seed: int = 0,
) -> Gathered:
    """Generate randomization ranges, each from data.

    They are of one robot, from its recordings and its model, or of a type of servo, from models of
    several units.

    Args:
        recordings: Bench and pool recordings (NAME.csv with NAME.json).
        robot: The robot that was recorded (robot.toml).
        model: Its fitted servos, and its body where that was calibrated (MODEL.json).
        population: Instead of these, models of units of one type of servo, UNIT=MODEL for each run
            of a unit that has several; in Python models, also in lists by unit.
        held_out: Name of the recording to check a fit to the others on; by default the last.
        steps: Most steps of each chain, which ends at 100 autocorrelation times.
        walkers: Walkers of each chain.
        chains: Path next to which the chains are kept, in files STEM.chain.JOINT.npz, so that an
            interrupted call continues where it stopped.
        interval: Probability of the intervals of the posterior, which are the ranges.
        seed: Seed of the chains.

    Returns:
        ``ranges``, which ``write_ranges`` writes, and the posteriors, latencies and densities, or
        the spreads between units and between runs, that they come from.

    Raises:
        InputError: If recordings, robot and model do not agree, or a chain is too short to have
            converged.
    """
    from dataclasses import replace

    from tqdm import tqdm

    from sim2real.arm.arm_loads import with_arm_loads
    from sim2real.output import provenance
    from sim2real.posterior.chain import chain_file
    from sim2real.ranges.gather import Gathered, Sampling, gather
    from sim2real.ranges.population import by_unit
    from sim2real.ranges.population import population as of_population

    _check_sampling("ranges", steps, walkers, seed, interval)
    if population:
        if recordings or robot is not None or model is not None:
            found = "--population with recordings, --robot or --model"
            raise InputError("ranges", "", found, "either models of several units or one robot")
        units, files = zip(*by_unit(population), strict=True)
        models = [*zip(units, map(model_of, files), strict=True)]
        drawn, parameters = of_population(models, interval)
        drawn = replace(drawn, provenance=provenance(files, seed))
        return Gathered(drawn, population=parameters)
    if robot is None or model is None:
        missing = "--robot" if robot is None else "--model"
        raise InputError(missing, "", "nothing", "a file, or --population with several models")
    loaded, description, fitted = recordings_to_fit(recordings), robot_of(robot), model_of(model)
    completed: dict[str, int] = {}

    def advance(joint: str, count: int) -> None:
        completed[joint] = count
        bar.update(sum(completed.values()) - bar.n)

    sampling = Sampling(steps, walkers, seed, held_out, progress=advance, level=interval)
    if chains is not None:
        out = Path(chains)
        sampling = replace(sampling, file=lambda joint: chain_file(out, joint))
    recorded, total = with_arm_loads(loaded, description, fitted), steps * len(fitted.joints)
    with tqdm(desc="ranges", total=total, unit="step", disable=None) as bar:
        gathered = gather(recorded, description, fitted, sampling)
    origin = provenance([*loaded, description, model], seed)
    return replace(gathered, ranges=replace(gathered.ranges, provenance=origin))


def predict(recordings: Recorded, robot: Robot | File | None, model: Model | File) -> Prediction:
    """Simulate a model from rest on the commands of recordings.

    Measured angles are not used. ``sim2real.servo.prediction.predict`` does the same with arrays.

    Args:
        recordings: Recordings, or tables of commands (t_s, J.command_rad) without measurements.
        robot: The robot, to check the names of the joints; not needed.
        model: The fitted servos (MODEL.json).

    Raises:
        InputError: If recordings, robot and model do not agree.
    """
    from sim2real.plausible import validate_commands
    from sim2real.servo.prediction import predict_recordings

    loaded = recordings_of(recordings, or_commands=True)
    if robot is not None:
        description = robot_of(robot)
        for recording in loaded:
            validate_commands(recording, description)
    return predict_recordings(loaded, model_of(model))


def latency(
    recordings: Recorded,
    robot: Robot | File | None = None,
    model: Model | File | None = None,
    *,
    episodes: int = 5,
    seed: int = 0,
) -> LatencySplit:
    """Split the latency by its causes: command, bus, sensor, observation and inference.

    No load needs to be known: a latency is a time, whatever the unit of the gains.

    Args:
        recordings: Recordings of record and swim, imported logs, or folders of LeRobot datasets.
        robot: The robot that was recorded (robot.toml); not needed.
        model: Its fitted servos (MODEL.json); by default they are identified, without
            a robot by two laws: linear, and with friction and a limit of the torque.
        episodes: Number of episodes of a LeRobot dataset to read, from the first.
        seed: Seed of the search for a starting point.

    Returns:
        Median and 90 % interval of each cause that the recordings show, and ``ranges``, which
        ``write_ranges`` writes.

    Raises:
        InputError: If no joint moves, or recordings and robot do not agree.
    """
    from sim2real.importers.lerobot import with_episodes
    from sim2real.output import provenance
    from sim2real.ranges.latency import split_latency, unknown_robot

    check_whole("latency", "episodes", episodes, 1)
    listed = recordings_to_fit(with_episodes(recordings, episodes))
    described = robot_of(robot) if robot else unknown_robot(listed)
    if model is not None:
        models = [model_of(model)]
    elif robot is not None:
        models = [identify(listed, described, seed=seed)]
    else:
        limited = ("coulomb_friction", "torque_saturation")
        models = [identify(listed, described, effects=x, seed=seed) for x in (limited, ())]
    return split_latency(listed, models, provenance([*listed, described, *models], seed))


def servos() -> ServoLibrary:
    """List the identified servos that ship with the package.

    ``servos()["NAME"]`` is one of them: its ``model`` can be used wherever a model is.
    """
    from sim2real.servo_library.catalogue import shipped

    return shipped()


def recordings_of(recordings: Recorded, *, or_commands: bool = False) -> list[Recording]:
    """The recordings, at least one, read from files, with ``or_commands`` also CSV without JSON."""
    from sim2real.recording import Recording, read_commands, read_recording

    sequence: object = recordings
    if isinstance(sequence, Recording | str | os.PathLike):
        sequence = [sequence]
    expected = "a recording, its CSV file, or a list of these"
    if not isinstance(sequence, Iterable):
        raise InputError("recordings", "", shown(sequence), expected)
    listed = []
    for entry in sequence:
        _check_type("recordings", entry, Recording, expected)
        if isinstance(entry, Recording):
            listed.append(entry)
        elif or_commands and not Path(entry).with_suffix(".json").exists():
            listed.append(read_commands(entry))
        else:
            listed.append(read_recording(entry))
    if not listed:
        raise InputError("recordings", "", "none", "at least one")
    return listed


def recordings_to_fit(recordings: Recorded) -> list[Recording]:
    """The recordings, read where files are given, with a warning of those that are simulated."""
    listed = recordings_of(recordings)
    simulated = [recording.file for recording in listed if recording.is_simulated]
    if simulated:
        import warnings

        sentence = "simulated, not measured; the fit is of that simulator, not of a robot"
        warnings.warn(f"{', '.join(simulated)}: {sentence}", stacklevel=3)
    return listed


def robot_of(robot: Robot | File) -> Robot:
    """The robot, read where a file is given."""
    from sim2real.robot import Robot, read_robot

    _check_type("robot", robot, Robot, "a robot or its robot.toml")
    return robot if isinstance(robot, Robot) else read_robot(robot)


def model_of(model: Model | File) -> Model:
    """The model, read where a file is given."""
    from sim2real.model import Model, read_model

    _check_type("model", model, Model, "a model or its MODEL.json")
    return model if isinstance(model, Model) else read_model(model)


def _check_type(argument: str, value: object, kind: type, expected: str) -> None:
    """Check that ``value`` is an object of this kind or the name of a file."""
    if not isinstance(value, kind | str | os.PathLike):
        raise InputError(argument, "", shown(value), expected)


def _check_sampling(verb: str, steps: int, walkers: int, seed: int, interval: float) -> None:
    check_positive(verb, "interval", interval, 1.0, "between 0 and 1")
    for name, value, least in (("steps", steps, 1), ("walkers", walkers, 2), ("seed", seed, 0)):
        check_whole(verb, name, value, least)
