"""Export to MuJoCo of the model whose simulation in MuJoCo is nearest to the servo."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec

import numpy as np

from sim2real.exporters.actuator import Export
from sim2real.exporters.expressible import Expressible, expressible, fitting_data
from sim2real.exporters.mujoco import expressed, mujoco
from sim2real.exporters.mujoco_bench import simulate
from sim2real.exporters.refit import FittingData
from sim2real.inference.least_squares import rms
from sim2real.model import JointModel, Model
from sim2real.recording import Recording
from sim2real.robot import Robot
from sim2real.servo.trace import Trace

BRISTLES = frozenset({"presliding_friction", "stribeck_friction"})
"""Effects with explicit integration in MuJoCo, inaccurate for stiff or damped bristles."""


@dataclass(frozen=True)
class Agreement:
    """Difference of the exported actuator, simulated in MuJoCo, from the servo.

    Attributes:
        joint: The joint.
        error_rad: RMS difference from ``what``.
        what: A held-out recording, or the full model.
    """

    joint: str
    error_rad: float
    what: str

    def __str__(self) -> str:
        """The difference in mrad."""
        error = f"{1e3 * self.error_rad:.2f} mrad RMS"
        return f"{self.joint}: this actuator in MuJoCo: {error} from {self.what}"


@dataclass(frozen=True)
class MujocoExport:
    """The export, the model that it expresses, and the difference of MuJoCo by joint."""

    export: Export
    expressible: Expressible
    agreement: tuple[Agreement, ...]


def mujoco_refit(
    model: Model, recordings: Sequence[Recording] = (), robot: Robot | None = None
) -> MujocoExport:
    """Export a model to MuJoCo, refitted without the effects that MuJoCo lacks.

    If MuJoCo is installed, the file is simulated. Joints with ``BRISTLES`` are then exported with
    Coulomb friction instead if its simulation is nearer to the fitted data.

    Args:
        model: The fitted model.
        recordings: Recordings to refit to, see ``expressible``.
        robot: Source of limits.
    """
    rough: list[JointModel] = []

    def has(joint: JointModel) -> Collection[str]:
        return expressed(joint) - BRISTLES if joint in rough else expressed(joint)

    def written() -> tuple[Expressible, Export]:
        result = expressible(model, has, recordings, robot)
        return result, mujoco(result.model, robot, result.dropped)

    result, export = written()
    if find_spec("mujoco") is None:
        return MujocoExport(export, result, ())
    data = {
        name: fitting_data(name, joint, recordings, robot) for name, joint in model.joints.items()
    }
    bristly = [name for name, joint in result.model.joints.items() if _bristly(joint)]
    if bristly:
        rough += [model.joints[name] for name in bristly]
        plainer = written()
        nearer = [name for name in bristly if _nearer(plainer[0], result, name, data[name])]
        rough[:] = [model.joints[name] for name in nearer]
        if nearer:
            result, export = plainer if nearer == bristly else written()
    agreement = tuple(_agreement(result, name, data[name]) for name in model.joints)
    return MujocoExport(export, result, agreement)


def _bristly(joint: JointModel) -> bool:
    return any(effect.effect in BRISTLES for effect in joint.effects)


def _nearer(candidate: Expressible, reference: Expressible, name: str, data: FittingData) -> bool:
    """Whether MuJoCo is nearer to the fitted data of a joint with the first model."""
    candidate_error, reference_error = (
        mujoco_error(x.model.joints[name], name, data.fitted) for x in (candidate, reference)
    )
    return candidate_error < reference_error


def _agreement(result: Expressible, name: str, data: FittingData) -> Agreement:
    joint = result.model.joints[name]
    if data.scored:
        error = mujoco_error(joint, name, data.scored)
        return Agreement(name, error, f"{data.held_out}, held out")
    return Agreement(name, mujoco_error(joint, name, data.own), "the full model")


def mujoco_error(joint: JointModel, name: str, traces: Sequence[Trace]) -> float:
    """RMS difference of MuJoCo from the used samples of traces, each with its load.

    Args:
        joint: A joint that MuJoCo expresses.
        name: Its name.
        traces: Commands and measured angles.

    Returns:
        The difference in rad.
    """
    errors = []
    for trace in traces:
        bench = joint if joint.per_inertia else replace(joint, load=trace.load)
        start = float(trace.position[np.isfinite(trace.position)][0])
        text = mujoco(Model({name: bench})).text
        angle = simulate(text, trace.t, {name: trace.command}, {name: start})[name]
        errors.append((angle - trace.position)[trace.used])
    return rms(errors)
