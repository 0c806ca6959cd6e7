"""The verbs of ``sim2real.verbs`` that need water: ``diagnose``, ``calibrate``, ``simulate``.

They are called as the others are; ``import sim2real`` offers them too, and loads them when used.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from sim.commands.calibrate import table, with_figures
from sim.commands.simulate import every_period
from sim.inference import calibrate as bodies
from sim.inference.calibrate import Calibrated
from sim.inference.diagnose_swims import diagnose_swims
from sim.inference.followed import by_followed_twin
from sim.inference.parameters import law_parameters, servo_parameters
from sim.inference.problem import HELD_OUT_SHARE
from sim.inference.swims import Swim, by_fluid, by_twin, swim_of
from sim2real.arguments import check_choice, check_whole
from sim2real.diagnose import diagnose as servos
from sim2real.diagnose.result import Diagnosis
from sim2real.errors import InputError
from sim2real.model import Model
from sim2real.plausible import validate_commands
from sim2real.recording import Commands, Recording
from sim2real.robot import Robot
from sim2real.verbs import File, Recorded, model_of, recordings_of, robot_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

POSE = ("body.x_m", "body.y_m", "body.yaw_rad")


def diagnose(
    recordings: Recorded,
    robot: Robot | File,
    model: Model | File | None = None,
    *,
    references: Recorded = (),
    seed: int = 0,
) -> Diagnosis:
    """Find the physics that a fitted servo leaves out, or, from swims, that the body does.

    Swims are diagnosed in the reduced-order twin; ``sim2real diagnose --water`` goes on in the
    fluid.

    Args:
        recordings: Recordings of servos, or of a robot that swims; not both.
        robot: The robot that was recorded.
        model: A model to start from; swims need one.
        references: Recordings from before: then only what has changed since is named.
        seed: Of everything random.

    Raises:
        InputError: If recordings, robot and model do not agree.
    """
    check_whole("diagnose", "seed", seed)
    given, known = recordings_of(recordings), robot_of(robot)
    before = recordings_of(references) if references else []
    start = None if model is None else model_of(model)
    swims = [one for one in given if one.kind == "pool" and POSE[0] in one.columns]
    if not swims:
        return servos.diagnose(given, known, model=start, references=before, seed=seed)
    if len(swims) < len(given):
        other = next(one for one in given if one not in swims)
        raise InputError(other.file, "kind", "a recording of a bench", "swims alone, or none")
    if start is None:
        raise InputError("diagnose", "model", "none", "the model of the servos, to swim with")
    seen, then = ([swim_of(one, known) for one in some] for some in (swims, before))
    return diagnose_swims(seen, start, known, by_followed_twin(known), references=then)


@dataclass(frozen=True)
class Calibration:
    """A body fitted to swims.

    Attributes:
        model: The calibrated model, with intervals (``body``) and errors (``fit``).
        before: The model that it started from.
        robot: The robot.
        swims: What was fitted, its last part held out.
        found: Parameters, their standard deviations and errors before and after.
    """

    model: Model
    before: Model
    robot: Robot
    swims: tuple[Swim, ...]
    found: Calibrated

    def __str__(self) -> str:
        """Parameters with 90 % intervals, and errors on what was held out."""
        return table(self.found, "twin", self.robot)

    def plot(self, swim: int = 0) -> Figure:
        """One swim as measured, and simulated before and after."""
        from sim.view.calibration_plot import comparison

        twin = by_twin(self.robot)
        return comparison(self.swims[swim], self.before, self.model, twin, self.robot)


def calibrate(
    recordings: Recorded,
    robot: Robot | File,
    model: Model | File,
    *,
    fit_gains: bool = False,
    held_out: float = HELD_OUT_SHARE,
) -> Calibration:
    """Fit the body in the water to swims, in the reduced-order twin.

    ``sim2real calibrate --fluid`` goes on in the fluid. Nothing in it is random.

    Args:
        recordings: Swims, with poses of the body.
        robot: The robot that was recorded.
        model: Its servos.
        fit_gains: Fit the servos' gains too, not only their latency.
        held_out: Share of each swim, at its end, that is scored and not fitted.

    Raises:
        InputError: If recordings, robot and model do not agree.
    """
    known, start = robot_of(robot), model_of(model)
    check_joints(start, known)
    swims = [swim_of(one, known) for one in recordings_of(recordings)]
    free = [*law_parameters(), *servo_parameters(start, known, gains=fit_gains)]
    found = bodies.calibrate(swims, start, free, by_twin(known), held_out=held_out)
    return Calibration(with_figures(found, known), start, known, tuple(swims), found)


@dataclass(frozen=True)
class Simulated:
    """Swims of a model.

    Attributes:
        swims: Pool recordings: commands, measured joint angles and the head's pose, every 20 ms.
    """

    swims: tuple[Recording, ...]

    def __str__(self) -> str:
        """How long and how far each robot swam."""
        lines = []
        for one in self.swims:
            x, y = (one.columns[name] for name in POSE[:2])
            way = float(np.hypot(np.diff(x), np.diff(y)).sum())
            away = float(np.hypot(x[-1] - x[0], y[-1] - y[0]))
            said = f"{one.name}: {one.duration_s:.2f} s, its head's way {way:.3f} m"
            lines.append(f"{said}, {away:.3f} m from where it began")
        return "\n".join(lines)

    def plot(self) -> Figure:
        """The ways of the heads, from above."""
        from sim2real.report.style import house_style, new_figure

        with house_style():
            figure = new_figure(420, "the ways of the heads, from above")
            axes = figure.subplots()
            for one in self.swims:
                axes.plot(one.columns[POSE[0]], one.columns[POSE[1]], label=one.name)
            axes.set_aspect("equal", adjustable="datalim")
            axes.set_xlabel("x, m")
            axes.set_title("y, m")
            axes.legend()
        return figure


def simulate(
    recordings: Recorded,
    robot: Robot | File,
    model: Model | File,
    *,
    fidelity: Literal["fluid", "twin"] = "fluid",
    cell_m: float = 0.02,
    device: str = "cpu",
) -> Simulated:
    """Swim the commands of recordings, in the fluid or in its twin.

    What was measured in them is not looked at, but for the first pose of a swim.

    Args:
        recordings: Whose commands are sent.
        robot: The robot.
        model: Its servos and its body.
        fidelity: The lattice-Boltzmann fluid, or its reduced-order twin.
        cell_m: Side of a cell of the fluid, in m.
        device: ``cpu`` or ``cuda:0``.

    Raises:
        InputError: If recordings, robot and model do not agree, or a set-point is missing.
        FloatingPointError: If the water became supersonic, and the robot was stopped.
    """
    check_choice("simulate", "fidelity", fidelity, ("fluid", "twin"))
    known, fitted = robot_of(robot), model_of(model)
    check_joints(fitted, known)
    on_fluid = {"cell_m": cell_m, "device": device, "threads": 2}
    twin = fidelity == "twin"
    water = by_twin(known, device=device) if twin else by_fluid(known, **on_fluid)
    swims = []
    for one in recordings_of(recordings):
        validate_commands(one, known)
        sent = {joint: one.command[:, j] for j, joint in enumerate(one.joints)}
        t, command = every_period(Commands(one.t, sent, one.loads), known, one.file)
        start = np.array([_first(one, name) for name in POSE])
        track = water([fitted], command, start)[0]
        if not np.isfinite(track).all():
            raise FloatingPointError(f"{one.name}: the water became supersonic")
        swims.append(_swum(one.name, known, t, command, track))
    return Simulated(tuple(swims))


def check_joints(model: Model, robot: Robot) -> None:
    """Make sure that the model has a servo for each of the robot's joints.

    Raises:
        InputError: If it lacks one.
    """
    for joint in robot.joints:
        if joint.name not in model.joints:
            known = ", ".join(model.joints) or "none"
            raise InputError("model", "joints", known, f"the robot's joint {joint.name}")


def _first(recording: Recording, column: str) -> float:
    known = recording.columns.get(column, np.zeros(0))
    finite = known[np.isfinite(known)]
    return float(finite[0]) if finite.size else 0.0


def _swum(name: str, robot: Robot, t: Array, command: Array, track: Array) -> Recording:
    return Recording(
        name=name,
        kind="pool",
        joints=tuple(joint.name for joint in robot.joints),
        t=t,
        command=command,
        position=track[:, 3:],
        medium="water",
        source=f"Simulated, not measured: a model on the commands of {name}.",
        columns=dict(zip(POSE, track[:, :3].T, strict=True)),
    )
