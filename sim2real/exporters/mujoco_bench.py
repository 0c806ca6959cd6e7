"""Simulation of an exported MuJoCo model, and export of the model whose simulation is nearest."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from typing import Any

import numpy as np

from sim2real.arrays import Array
from sim2real.errors import InputError, library
from sim2real.exporters.actuator import SATURATION, Export
from sim2real.exporters.mujoco import INTEGRATOR, TIMESTEP_S, expressed, mujoco
from sim2real.exporters.nearest import Nearest, Which, fitting_data, nearest, rollout_error
from sim2real.inference.least_squares import rms
from sim2real.model import JointModel, Model
from sim2real.recording import Recording
from sim2real.robot import Robot
from sim2real.servo.trace import Trace

CASES = (("implicitfast", 0.002), ("implicitfast", 0.005), ("Euler", 0.002), ("Euler", 0.005))
"""Integrators and time steps in s of people's models, the last but one MuJoCo's default."""

BRISTLES = frozenset({"presliding_friction", "stribeck_friction"})
"""Effects with explicit integration in MuJoCo, inaccurate for stiff or damped bristles."""


def simulate(
    robot: Any,  # noqa: ANN401 - text, or MuJoCo's own type
    t: Array,
    command: Mapping[str, Array],
    start: Mapping[str, float] | None = None,
    *,
    integrator: str | None = None,
    timestep_s: float | None = None,
    drives: Mapping[str, str] | None = None,
) -> dict[str, Array]:
    """Simulated sensor angles in rad (T,) by joint, of an exported model for given commands.

    The robot is the text of an exported model, or compiled; it starts from its first keyframe, if
    any. Times ``t`` in s and set-points in rad are of shape (T,), without NaN. Joints start at rest
    on the first set-points, or at the angles ``start``; integrator (``"Euler"``, ...) and time step
    are by default the model's. ``drives`` are names of actuators that differ from their joint's.
    ``InputError`` if MuJoCo is not installed or the model lacks a joint.
    """
    mj = library("mujoco", "mujoco")
    model = mj.MjModel.from_xml_string(robot) if isinstance(robot, str) else robot
    if integrator is not None:
        model.opt.integrator = getattr(mj.mjtIntegrator, f"mjINT_{integrator.upper()}")
    step_s = model.opt.timestep = timestep_s or model.opt.timestep
    data = mj.MjData(model)
    if model.nkey:
        mj.mj_resetDataKeyframe(model, data, 0)
    joints = [model.sensor(k).name.removesuffix("_position") for k in range(model.nsensor)]
    since = (t - t[0]) / step_s
    ticks = np.arange(math.ceil(since[-1]) + 1)
    # Before MuJoCo 4 every actuator has one set-point.
    addresses = getattr(model, "actuator_ctrladr", np.arange(model.nu))
    controls = {}
    for joint, values in command.items():
        if joint not in joints:
            raise InputError("commands", joint, "no such joint", f"one of {', '.join(joints)}")
        drive, first = model.actuator((drives or {}).get(joint, joint)), float(values[0])
        delay_s = float(model.actuator_delay[drive.id])
        # MuJoCo delays by whole ticks; the integrator uses the speed at the end of a step, which
        # is half a step early.
        delay = delay_s / step_s
        beyond = delay - math.ceil(delay - 1e-6) + 0.5
        active = np.searchsorted(np.rint(since + beyond), ticks, side="right") - 1
        controls[int(addresses[drive.id])] = np.asarray(values, float)[np.maximum(active, 0)]
        place = model.joint(joint).qposadr[0]
        data.qpos[place] = model.qpos0[place] + (start or {}).get(joint, first)
        # a filter or rate limit has its set-point as state; an integral, the last state, is 0
        slews = model.actuator_dynprm[drive.id][1] > 0
        if drive.actnum[0] and (slews or drive.dyntype[0] == int(mj.mjtDyn.mjDYN_FILTEREXACT)):
            data.act[drive.actadr[0]] = first
        if delay_s > 0:
            samples = int(model.actuator_history[drive.id][0])
            times = step_s * np.arange(-samples, 0)
            mj.mj_initCtrlHistory(model, data, drive.id, times, np.full(samples, first))
    sensors = {joint: model.sensor(f"{joint}_position").adr[0] for joint in command}
    angles = {joint: np.empty(ticks.size) for joint in command}
    for tick in ticks:
        for index, held in controls.items():
            data.ctrl[index] = held[tick]
        mj.mj_step1(model, data)
        for joint, address in sensors.items():
            angles[joint][tick] = data.sensordata[address]
        mj.mj_step2(model, data)
    return {joint: np.interp(since, ticks, values) for joint, values in angles.items()}


@dataclass(frozen=True)
class Agreement:
    """Difference of the exported actuator, simulated in MuJoCo, from the servo."""

    joint: str
    error_rad: float  # RMS difference from ``what``
    what: str  # a held-out recording, or the full model
    # ``integrator``, ``timestep_s`` and ``error_rad`` of each of ``CASES``
    coarse: Sequence[Mapping[str, Any]] = field(default_factory=list)

    def __str__(self) -> str:
        """The differences in mrad."""
        error = f"{1e3 * self.error_rad:.2f} mrad RMS"
        text = f"{self.joint}: this actuator in MuJoCo: {error} from {self.what}"
        text += f" ({INTEGRATOR}, {1e3 * TIMESTEP_S:g} ms)"
        return text + "".join(
            f"; {one['integrator']}, {1e3 * one['timestep_s']:g} ms: {1e3 * one['error_rad']:.2f}"
            for one in self.coarse
        )


def mujoco_export(
    model: Model,
    recordings: Sequence[Recording] = (),
    robot: Robot | None = None,
    which: Which = "nearest",
) -> tuple[Export, Nearest, list[Agreement]]:
    """Export a model to MuJoCo, refitted without the effects that MuJoCo lacks, see `nearest`.

    If MuJoCo is installed, the file is simulated, at the time steps of ``CASES`` as well, and the
    errors by which `nearest` chooses are those of MuJoCo. Joints with ``BRISTLES`` are then
    exported with Coulomb friction instead if its simulation is nearer to the data. Also returns the
    model that is expressed, and the difference of MuJoCo by joint.
    """
    installed = find_spec("mujoco") is not None
    result = nearest(
        model,
        expressed,
        recordings,
        robot,
        which=which,
        rough=BRISTLES if installed else (),
        costly=(SATURATION,),
        error=mujoco_error if installed else rollout_error,
    )
    agreement, names = [], ("integrator", "timestep_s", "error_rad")
    for name, joint in model.joints.items() if installed else ():
        data, found = fitting_data(name, joint, recordings, robot), result.model.joints[name]
        traces, what = data.own, "the full model"
        if data.scored:
            traces, what = data.scored, f"{data.held_out}, held out"
        rows = [(*case, mujoco_error(found, name, traces, *case)) for case in CASES]
        coarse = [dict(zip(names, row, strict=True)) for row in rows]
        agreement.append(Agreement(name, mujoco_error(found, name, traces), what, coarse))
    remarks = [str(one) for one in agreement]
    return mujoco(result.model, robot, result.dropped, remarks), result, agreement


def mujoco_error(
    joint: JointModel,
    name: str,
    traces: Sequence[Trace],
    integrator: str = INTEGRATOR,
    timestep_s: float = TIMESTEP_S,
) -> float:
    """RMS difference in rad of MuJoCo from traces, each with its load; infinite if it diverges."""
    errors = []
    for trace in traces:
        bench = joint if joint.per_inertia else replace(joint, load=trace.load)
        text = mujoco(Model({name: bench})).text
        start = {name: float(trace.position[np.isfinite(trace.position)][0])}
        sent, step = {name: trace.command}, timestep_s
        angle = simulate(text, trace.t, sent, start, integrator=integrator, timestep_s=step)
        errors.append((angle[name] - trace.position)[trace.used])
    error = rms(errors)
    return error if np.isfinite(error) else float("inf")
