"""Export to MuJoCo of the model whose simulation in MuJoCo is nearest to the servo."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from typing import Any

import numpy as np

from sim2real.exporters.actuator import SATURATION, Export
from sim2real.exporters.expressible import (
    Expressible,
    Which,
    expressible,
    fitting_data,
    rollout_error,
)
from sim2real.exporters.mujoco import INTEGRATOR, TIMESTEP_S, expressed, mujoco
from sim2real.exporters.mujoco_bench import simulate
from sim2real.exporters.refit import FittingData
from sim2real.inference.least_squares import rms
from sim2real.model import JointModel, Model
from sim2real.recording import Recording
from sim2real.robot import Robot
from sim2real.servo.trace import Trace

CASES = (("implicitfast", 0.002), ("implicitfast", 0.005), ("Euler", 0.002), ("Euler", 0.005))
"""Integrators and time steps in s of people's models, the last but one MuJoCo's default."""

BRISTLES = frozenset({"presliding_friction", "stribeck_friction"})
"""Effects with explicit integration in MuJoCo, inaccurate for stiff or damped bristles."""


@dataclass(frozen=True)
class Agreement:
    """Difference of the exported actuator, simulated in MuJoCo, from the servo.

    Attributes:
        joint: The joint.
        error_rad: RMS difference from ``what``.
        what: A held-out recording, or the full model.
        coarse_rad: The same by integrator and time step in s, for those of ``CASES``.
    """

    joint: str
    error_rad: float
    what: str
    coarse_rad: Mapping[tuple[str, float], float] = field(default_factory=dict)

    def content(self) -> dict[str, Any]:
        """The differences for JSON."""
        return {
            "joint": self.joint,
            "error_rad": self.error_rad,
            "what": self.what,
            "coarse": [
                {"integrator": integrator, "timestep_s": step, "error_rad": error}
                for (integrator, step), error in self.coarse_rad.items()
            ],
        }

    def __str__(self) -> str:
        """The differences in mrad."""
        error = f"{1e3 * self.error_rad:.2f} mrad RMS"
        text = f"{self.joint}: this actuator in MuJoCo: {error} from {self.what}"
        text += f" ({INTEGRATOR}, {1e3 * TIMESTEP_S:g} ms)"
        return text + "".join(
            f"; {integrator}, {1e3 * step:g} ms: {1e3 * error:.2f}"
            for (integrator, step), error in self.coarse_rad.items()
        )


@dataclass(frozen=True)
class MujocoExport:
    """The export, the model that it expresses, and the difference of MuJoCo by joint."""

    export: Export
    expressible: Expressible
    agreement: tuple[Agreement, ...]


def mujoco_refit(
    model: Model,
    recordings: Sequence[Recording] = (),
    robot: Robot | None = None,
    which: Which = "nearest",
) -> MujocoExport:
    """Export a model to MuJoCo, refitted without the effects that MuJoCo lacks.

    If MuJoCo is installed, the file is simulated, at the time steps of ``CASES`` as well, and the
    errors by which `expressible` chooses are those of MuJoCo. Joints with ``BRISTLES`` are then
    exported with Coulomb friction instead if its simulation is nearer to the data.

    Args:
        model: The fitted model.
        recordings: Recordings to refit to, see ``expressible``.
        robot: Source of limits.
        which: Which model to export, see ``expressible``.
    """
    installed = find_spec("mujoco") is not None
    result = expressible(
        model,
        expressed,
        recordings,
        robot,
        which=which,
        rough=BRISTLES if installed else (),
        costly=(SATURATION,),
        error=mujoco_error if installed else rollout_error,
    )
    agreement: tuple[Agreement, ...] = ()
    if installed:
        data = {
            name: fitting_data(name, joint, recordings, robot)
            for name, joint in model.joints.items()
        }
        agreement = tuple(_agreement(result, name, data[name]) for name in model.joints)
    export = mujoco(result.model, robot, result.dropped, remarks=[*map(str, agreement)])
    return MujocoExport(export, result, agreement)


def _agreement(result: Expressible, name: str, data: FittingData) -> Agreement:
    joint = result.model.joints[name]
    traces, what = data.own, "the full model"
    if data.scored:
        traces, what = data.scored, f"{data.held_out}, held out"
    errors = {case: mujoco_error(joint, name, traces, *case) for case in CASES}
    return Agreement(name, mujoco_error(joint, name, traces), what, errors)


def mujoco_error(
    joint: JointModel,
    name: str,
    traces: Sequence[Trace],
    integrator: str = INTEGRATOR,
    timestep_s: float = TIMESTEP_S,
) -> float:
    """RMS difference of MuJoCo from the used samples of traces, each with its load.

    Args:
        joint: A joint that MuJoCo expresses.
        name: Its name.
        traces: Commands and measured angles.
        integrator: Integrator of MuJoCo, by default that of the exported file.
        timestep_s: Time step in s, by default that of the exported file.

    Returns:
        The difference in rad; infinite if MuJoCo's simulation diverges.
    """
    errors = []
    for trace in traces:
        bench = joint if joint.per_inertia else replace(joint, load=trace.load)
        start = float(trace.position[np.isfinite(trace.position)][0])
        text = mujoco(Model({name: bench})).text
        command = {name: trace.command}
        angle = simulate(
            text, trace.t, command, {name: start}, integrator=integrator, timestep_s=timestep_s
        )[name]
        errors.append((angle - trace.position)[trace.used])
    error = rms(errors)
    return error if np.isfinite(error) else float("inf")
