"""The MuJoCo model of a servo that is nearest to it when MuJoCo itself runs it."""

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
"""Effects that MuJoCo steps explicitly, and not well where their bristles are stiff or damped."""


@dataclass(frozen=True)
class Agreement:
    """How far MuJoCo, running the exported actuator on each recording's load, is from it.

    Attributes:
        joint: The joint.
        error_rad: RMS difference from ``what``.
        what: A recording that was held out, or the full model.
    """

    joint: str
    error_rad: float
    what: str

    def __str__(self) -> str:
        """The difference in mrad."""
        error = f"{1e3 * self.error_rad:.2f} mrad RMS"
        return f"{self.joint}: MuJoCo, running this actuator: {error} from {self.what}"


@dataclass(frozen=True)
class MujocoExport:
    """The export, the model that it expresses, and how far MuJoCo is from it by joint."""

    export: Export
    expressible: Expressible
    agreement: tuple[Agreement, ...]


def mujoco_refit(
    model: Model, recordings: Sequence[Recording] = (), robot: Robot | None = None
) -> MujocoExport:
    """Export a model to MuJoCo, refitted without what MuJoCo lacks.

    Where MuJoCo is installed it runs the file. Joints with ``BRISTLES`` are then exported with
    plain dry friction in their place if that comes nearer to what they were fitted to.

    Args:
        model: The fitted model.
        recordings: What to refit to, see ``expressible``.
        robot: Gives limits, if there is one.
    """
    rough: list[JointModel] = []

    def has(joint: JointModel) -> Collection[str]:
        return expressed(joint) - BRISTLES if joint in rough else expressed(joint)

    def written() -> tuple[Expressible, Export]:
        found = expressible(model, has, recordings, robot)
        return found, mujoco(found.model, robot, found.dropped)

    found, export = written()
    if find_spec("mujoco") is None:
        return MujocoExport(export, found, ())
    data = {
        name: fitting_data(name, joint, recordings, robot) for name, joint in model.joints.items()
    }
    rough += [model.joints[name] for name, joint in found.model.joints.items() if _bristly(joint)]
    if rough:
        plainer = written()[0]
        rough[:] = [
            model.joints[name]
            for name in model.joints
            if model.joints[name] in rough and _nearer(plainer, found, name, data[name])
        ]
        found, export = written()
    agreement = tuple(_agreement(found, name, data[name]) for name in model.joints)
    return MujocoExport(export, found, agreement)


def _bristly(joint: JointModel) -> bool:
    return any(effect.effect in BRISTLES for effect in joint.effects)


def _nearer(one: Expressible, other: Expressible, name: str, data: FittingData) -> bool:
    """Whether MuJoCo comes nearer to what a joint was fitted to with one model than the other."""
    first, second = (mujoco_error(x.model.joints[name], name, data.fitted) for x in (one, other))
    return first < second


def _agreement(found: Expressible, name: str, data: FittingData) -> Agreement:
    joint = found.model.joints[name]
    if data.scored:
        error = mujoco_error(joint, name, data.scored)
        return Agreement(name, error, f"{data.held_out}, held out")
    return Agreement(name, mujoco_error(joint, name, data.own), "the full model")


def mujoco_error(joint: JointModel, name: str, traces: Sequence[Trace]) -> float:
    """RMS difference of MuJoCo from the used samples of traces of a joint, each on its own load.

    Args:
        joint: A joint that MuJoCo expresses.
        name: Its name.
        traces: What was sent and measured.

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
