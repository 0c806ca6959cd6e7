"""The verbs of ``sim2real.verbs`` that need the fluid or its twin; loaded when used.

Like ``sim2real.verbs``, this module imports nothing heavy.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from sim2real.errors import InputError, check_choice, check_positive, check_whole
from sim2real.verbs import model_of, recordings_of, recordings_to_fit, robot_of

if TYPE_CHECKING:
    from sim.inference.calibration import Calibration
    from sim.simulation import Simulated
    from sim2real.design.plan import Design
    from sim2real.design.rivals import Request, RivalDesign
    from sim2real.diagnose.result import Diagnosis
    from sim2real.model import Model
    from sim2real.robot import Robot
    from sim2real.verbs import File, Recorded


def diagnose(
    recordings: Recorded,
    robot: Robot | File,
    model: Model | File | None = None,
    *,
    references: Recorded = (),
    diagnosis: File | None = None,
    negligible: float = 0.05,
    in_water: File | None = None,
    device: str = "cpu",
    effort: float = 1.0,
    interval: float = 0.9,
    seed: int = 0,
) -> Diagnosis:
    """Find the physics that a fitted servo leaves out, or, from swims, that the body does.

    Args:
        recordings: Recordings of servos, or of a robot that swims; not both (NAME.csv with
            NAME.json).
        robot: The robot that was recorded (robot.toml).
        model: A model to start from; swims need one (MODEL.json).
        references: Earlier recordings of the same robot; only what has changed since is reported.
        diagnosis: Servos only. A diagnosis of some of the recordings (diagnosis.json): the sets of
            effects that it left open are tried again.
        negligible: An effect that changes the held-out error by less than this share is listed and
            does not change the verdict.
        in_water: Swims only. The fluid first simulates the recorded commands (a minute on a GPU),
            the result is kept in this file (.npz), or read from it, and the twin predicts only the
            differences.
        device: Device that simulates the fluid, cpu or cuda:0.
        effort: Servos only. Multiple of the simulation budget of the search for combinations of
            effects; the diagnosis states which joints have spent it.
        interval: Servos only. Probability of the intervals of parameters.
        seed: Seed of the bootstraps.

    Raises:
        InputError: If recordings, robot and model do not agree.
    """
    check_whole("diagnose", "seed", seed)
    check_positive("diagnose", "effort", effort)
    check_positive("diagnose", "interval", interval, 1.0, "between 0 and 1")
    read, machine = recordings_to_fit(recordings), robot_of(robot)
    earlier = recordings_to_fit(references) if references else []
    start = None if model is None else model_of(model)
    swims = [recording for recording in read if recording.is_swim]
    if not swims:
        from sim2real.diagnose.diagnose import diagnose as diagnose_servos
        from sim2real.progress import progress_bar

        if in_water is not None:
            found, expected = "recordings of a bench", "swims in a pool"
            raise InputError("diagnose", "in_water", found, expected)
        with progress_bar("diagnose") as progress:
            return diagnose_servos(
                read, machine, model=start, references=earlier, earlier=diagnosis,
                negligible=negligible, effort=effort, interval=interval, seed=seed,
                progress=progress,
            )  # fmt: skip
    if len(swims) < len(read):
        bench_recording = next(recording for recording in read if recording not in swims)
        found, expected = "a recording of a bench", "swims alone, or none"
        raise InputError(bench_recording.file, "kind", found, expected)
    if start is None:
        raise InputError("diagnose", "model", "none", "the model of the servos, to swim with")
    if diagnosis is not None:
        raise InputError("diagnose", "diagnosis", "swims in a pool", "recordings of a bench")
    from dataclasses import replace

    from sim.inference.diagnose_swims import diagnose_recorded_swims
    from sim2real.plausible import admitted

    _, warnings = admitted([*swims, *earlier], machine)
    water_file = None if in_water is None else Path(in_water)
    diagnosed = diagnose_recorded_swims(
        swims, start, machine, references=earlier, in_water=water_file, device=device
    )
    return replace(diagnosed, warnings=warnings)


def calibrate(
    recordings: Recorded,
    robot: Robot | File,
    model: Model | File,
    *,
    fit_gains: bool = False,
    held_out: float = 1 / 3,
    fluid: bool = False,
    device: str = "cpu",
    cell_m: float = 0.02,
    rollouts: int = 48,
    seed: int = 0,
) -> Calibration:
    """Fit the body in the water to swims, in the reduced-order twin and then in the fluid.

    Args:
        recordings: Swims, with poses of the body (NAME.csv with NAME.json).
        robot: The robot that was recorded (robot.toml).
        model: Its servos (MODEL.json).
        fit_gains: Fit the servos' gains too, and not only their latencies.
        held_out: Share of each swim, at its end, that is scored and not fitted.
        fluid: Continue the fit in the fluid, which needs a GPU.
        device: Device that simulates the fluid, cpu or cuda:0.
        cell_m: Side of a cell of the fluid, in m.
        rollouts: Rollouts of a batch in the fluid.
        seed: Seed of the designs of the fluid's batches.

    Raises:
        InputError: If recordings, robot and model do not agree, or the fluid stops the robot.
    """
    from dataclasses import replace

    from sim.inference.calibration import calibrate_in_fluid, calibrate_in_twin
    from sim.inference.swims import FLUID_THREADS, by_fluid, swim_of
    from sim2real.output import provenance
    from sim2real.plausible import admitted

    machine, start = robot_of(robot), model_of(model)
    check_joints(start, machine)
    read = recordings_to_fit(recordings)
    _, notes = admitted(read, machine)
    swims = [swim_of(recording, machine) for recording in read]
    calibration = calibrate_in_twin(swims, start, machine, gains=fit_gains, held_out=held_out)
    if fluid:
        calibration = calibrate_in_fluid(
            calibration,
            lambda side: by_fluid(machine, cell_m=side, device=device, threads=FLUID_THREADS),
            cell_m=cell_m, rollouts=rollouts, gains=fit_gains, held_out=held_out, seed=seed,
        )  # fmt: skip
    origin = provenance([*read, machine, model], seed)
    calibrated = calibration.model
    notes = (*calibrated.notes, *(note for note in notes if note not in calibrated.notes))
    return replace(calibration, model=replace(calibrated, provenance=origin, notes=notes))


def fit_twin(
    robot: Robot | File,
    model: Model | File,
    *,
    cell_m: float = 0.02,
    device: str = "cpu",
    seconds: float = 6.0,
) -> Model:
    """Fit the force law of the twin to a robot in the fluid, minutes on a CPU.

    The robot swims 24 signals in the fluid; six of them are held out of the fit and scored. The
    result is the model with the law in its body and, in ``fit``, relative errors of the twin.

    Args:
        robot: The robot (robot.toml).
        model: Its servos (MODEL.json).
        cell_m: Side of a cell of the fluid, in m.
        device: Device that simulates the fluid, cpu or cuda:0.
        seconds: Duration of each swim, s.

    Raises:
        InputError: If robot and model do not agree, or the fluid stops the robot.
    """
    from dataclasses import replace

    from sim.twin import fit
    from sim2real.output import provenance
    from sim2real.progress import progress_bar

    check_positive("fit-twin", "seconds", seconds)
    check_positive("fit-twin", "cell_m", cell_m)
    machine, servos = robot_of(robot), model_of(model)
    check_joints(servos, machine)
    with progress_bar("fluid") as progress:
        swims = fit.swum(machine, servos, seconds, progress, cell_m=cell_m, device=device)
    with progress_bar("fit") as progress:
        found = fit.fit_twin(servos, swims, progress)
    return replace(found, provenance=provenance([robot, model], None))


def simulate(
    recordings: Recorded,
    robot: Robot | File,
    model: Model | File,
    *,
    fidelity: Literal["fluid", "twin"] = "fluid",
    cell_m: float = 0.02,
    device: str = "cpu",
    dimensions: int = 3,
    walls: bool = False,
    plot: File | None = None,
    video: File | None = None,
) -> Simulated:
    """Simulate the commands of recordings in the fluid or in its twin.

    Measurements are not used, except for the first pose of a swim.

    Args:
        recordings: Recordings, or tables of commands (t_s, J.command_rad) without measurements.
        robot: The robot (robot.toml).
        model: Its servos and its body (MODEL.json).
        fidelity: The lattice-Boltzmann fluid or its reduced-order twin.
        cell_m: Side of a cell of the fluid, in m.
        device: Device that simulates, cpu or cuda:0.
        dimensions: 3, or 2 for a fluid in the plane.
        walls: Simulate a closed box, and not one that follows the robot.
        plot: PNG file for the flow at the end.
        video: MP4, AVI or GIF file for a video of the flow.

    Raises:
        InputError: If recordings, robot and model do not agree, or a set-point is missing.
        FloatingPointError: If the flow became supersonic, and the robot was stopped.
    """
    from sim.simulation import Simulated, simulate_recording
    from sim.view.picture import check_picture
    from sim.view.video import check_video

    check_choice("simulate", "fidelity", fidelity, ("fluid", "twin"))
    if plot is not None:
        check_picture(Path(plot))
    if video is not None:
        check_video(video)
    if fidelity == "twin" and (plot is not None or video is not None):
        raise InputError("simulate", "fidelity", "'twin'", "'fluid', for a picture of the flow")
    read = recordings_of(recordings, or_commands=True)
    machine, fitted = robot_of(robot), model_of(model)
    if len(read) > 1 and (plot is not None or video is not None):
        raise InputError("simulate", "recordings", str(len(read)), "one, for a picture of the flow")
    check_joints(fitted, machine)
    swims = (
        simulate_recording(
            recording, machine, fitted, fidelity=fidelity, cell_m=cell_m, device=device,
            dimensions=dimensions, walls=walls, plot=plot, video=video,
        )
        for recording in read
    )  # fmt: skip
    return Simulated(tuple(swims))


def design(
    robot: Robot | File,
    model: Model | File | None = None,
    *,
    diagnosis: File | None = None,
    contexts: File | None = None,
    again: bool = False,
    seconds: float = 30.0,
    inertia: Sequence[str] | None = None,
    pendulum: Sequence[str] | None = None,
    seed: int = 0,
) -> Design | RivalDesign:
    """Design the commands to record next: they determine the servos, or tell rival effects apart.

    Args:
        robot: The robot, with its limits and data sheets (robot.toml).
        model: Its fitted servos (MODEL.json); without it, what the data sheets say.
        diagnosis: A diagnosis (diagnosis.json): the commands are to tell the sets of effects apart
            that it leaves open. It has the servos and their loads. That of swims leads to a swim.
        contexts: What can be changed besides the commands (contexts.toml): loads, supply voltage,
            firmware gain; with a diagnosis.
        again: With a diagnosis that leaves one set of effects: look for effects that would have
            stayed hidden.
        seconds: Duration of the recording, s.
        inertia: Load of a joint, J=KGM2: inertia on its output shaft without the rotor; by default
            that of the model, or an unknown one.
        pendulum: Load of a joint, J=KG,M: mass that hangs straight down at angle 0, and its
            distance from the shaft.
        seed: Seed of the search.

    Returns:
        The design: ``recording()`` has the commands, ``joints`` what is expected of them.

    Raises:
        InputError: If limits contradict each other, the duration is too short, the robot and the
            model or the diagnosis do not agree, or the diagnosis leaves nothing open.
    """
    import warnings
    from dataclasses import replace

    from sim2real.output import provenance
    from sim2real.progress import progress_bar

    check_whole("design", "seed", seed)
    description = robot_of(robot)
    if diagnosis is not None:
        from sim2real.design.rivals import Request

        for name, given in (("model", model), ("inertia", inertia), ("pendulum", pendulum)):
            if given is not None:
                both = f"--{name} with --diagnosis, which has the servos and their loads"
                raise InputError("design", name, both, f"no --{name}")
        with progress_bar("design") as progress:
            request = Request(seconds, again, seed, diagnosis, progress)
            apart = _telling_apart(diagnosis, description, contexts, request)
        return replace(apart, provenance=provenance([robot, diagnosis, contexts], seed))
    if contexts is not None or again:
        name = "again" if again else "contexts"
        raise InputError("design", name, f"--{name} without --diagnosis", "--diagnosis as well")
    from sim2real.design.plan import design as plan
    from sim2real.design.plan import stated_loads

    fitted = None if model is None else model_of(model)
    for note in () if fitted is None else fitted.notes:
        warnings.warn(f"the model's fit: {note}", stacklevel=2)
    loads = stated_loads(description, fitted, inertia, pendulum)
    with progress_bar("design") as progress:
        found = plan(
            description, fitted, seconds=seconds, loads=loads, seed=seed, progress=progress
        )
    return replace(found, provenance=provenance([robot, model], seed))


def _telling_apart(
    diagnosis: File, robot: Robot, contexts: File | None, request: Request
) -> RivalDesign:
    """The recording that tells the rivals of a diagnosis apart: of servos, or a swim."""
    from sim2real.design.rivals import design_for_rivals
    from sim2real.diagnose.rival_sets import read_diagnosis, read_rival_sets, read_swim_rivals

    found = read_diagnosis(diagnosis)
    if found.content.get("swim_rivals") is not None:
        from sim.inference.design_swim import design_swim

        if contexts is not None:
            given, expected = "--contexts with a diagnosis of swims", "no --contexts"
            raise InputError("design", "contexts", given, expected)
        rivals = read_swim_rivals(found)
        fitted = model_of(Path(diagnosis).parent / found.text("model"))
        check_joints(fitted, robot)
        return design_swim(rivals, fitted, robot, request)
    from sim2real.design.limits import read_contexts

    offered = () if contexts is None else read_contexts(contexts)
    return design_for_rivals(read_rival_sets(found), robot, request, offered)


def check_joints(model: Model, robot: Robot) -> None:
    """Check that the model has a servo for each of the robot's joints."""
    for joint in robot.joints:
        if joint.name not in model.joints:
            known = ", ".join(model.joints) or "none"
            raise InputError("model", "joints", known, f"the robot's joint {joint.name}")
