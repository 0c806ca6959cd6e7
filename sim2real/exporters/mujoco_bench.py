"""Simulation of an exported MuJoCo model, with delays also for versions without them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim2real.arrays import Array
from sim2real.errors import InputError
from sim2real.extras import library


def simulate(
    xml: str,
    t: Array,
    command: Mapping[str, Array],
    start: Mapping[str, float] | None = None,
    *,
    integrator: str | None = None,
    timestep_s: float | None = None,
) -> dict[str, Array]:
    """Simulated sensor angles of an exported model for given commands.

    A set-point takes effect after the latency: by the ``delay`` of the actuator if this version of
    MuJoCo has it, else by writing it to ``ctrl`` later. The model starts at rest on the first
    set-points.

    Args:
        xml: The model, as `mujoco.mujoco` writes it.
        t: Times in s, shape (T,), increasing.
        command: Set-points in rad by joint, each of shape (T,), without NaN.
        start: Initial angle in rad by joint; default: the first set-point.
        integrator: ``"Euler"``, ``"implicitfast"``, ...; default: that of the model.
        timestep_s: Time step in s; default: that of the model.

    Returns:
        Angles in rad by joint, each of shape (T,).

    Raises:
        InputError: If MuJoCo is not installed or the model lacks a joint.
    """
    mj = library("mujoco", "mujoco")
    model = mj.MjModel.from_xml_string(xml)
    if integrator is not None:
        model.opt.integrator = getattr(mj.mjtIntegrator, f"mjINT_{integrator.upper()}")
    if timestep_s is not None:
        model.opt.timestep = timestep_s
    data = mj.MjData(model)
    joints = [model.sensor(k).name.removesuffix("_position") for k in range(model.nsensor)]
    for joint in command:
        if joint not in joints:
            raise InputError("commands", joint, "no such joint", f"one of {', '.join(joints)}")
    step = model.opt.timestep
    since = (t - t[0]) / step
    final = math.ceil(since[-1])
    controls = {}
    for joint, values in command.items():
        sent = np.rint(since + _delay_ticks(model, joint, step)).astype(int)
        controls[_input(model, joint)] = _held_values(sent, np.asarray(values, float), final + 1)
        _rest(mj, model, data, joint, float(values[0]), (start or {}).get(joint))
    sensors = {joint: model.sensor(f"{joint}_position").adr[0] for joint in command}
    angles = {joint: np.empty(final + 1) for joint in command}
    for tick in range(final + 1):
        for index, values in controls.items():
            data.ctrl[index] = values[tick]
        mj.mj_step1(model, data)
        for joint, address in sensors.items():
            angles[joint][tick] = data.sensordata[address]
        mj.mj_step2(model, data)
    ticks = np.arange(final + 1)
    return {joint: np.interp(since, ticks, values) for joint, values in angles.items()}


def _input(model: Any, joint: str) -> int:  # noqa: ANN401 - MuJoCo's own types
    """Index of the set-point of a joint in ``ctrl``."""
    actuator = model.actuator(joint).id
    addresses = getattr(model, "actuator_ctrladr", None)
    return int(actuator if addresses is None else addresses[actuator])


def _delay_ticks(model: Any, joint: str, step: float) -> float:  # noqa: ANN401
    """Delay of the commands of a joint in ticks, as far as the model does not apply it."""
    # The integrator uses the speed at the end of a step, which is half a step early.
    ticks = float(model.numeric(f"{joint}_latency_s").data[0]) / step
    delays = getattr(model, "actuator_delay", None)
    if delays is not None and delays[model.actuator(joint).id] > 0:
        return ticks - math.ceil(ticks - 1e-6) + 0.5
    return ticks + 0.5


def _held_values(changes: NDArray[np.int_], values: Array, ticks: int) -> Array:
    """The active set-point at each tick, shape (ticks,); initially the first."""
    active = np.searchsorted(changes, np.arange(ticks), side="right") - 1
    return values[np.maximum(active, 0)]


def _rest(
    mj: Any,  # noqa: ANN401
    model: Any,  # noqa: ANN401
    data: Any,  # noqa: ANN401
    joint: str,
    command: float,
    angle: float | None,
) -> None:
    """Set a joint and the state of its actuator to rest on its first set-point."""
    angle_address = model.joint(joint).qposadr[0]
    data.qpos[angle_address] = model.qpos0[angle_address] + (command if angle is None else angle)
    actuator = model.actuator(joint)
    # A filter or rate limit has its set-point as state; an integral, the last state, starts at 0.
    address, count = int(actuator.actadr[0]), int(actuator.actnum[0])
    slews = model.actuator_dynprm[actuator.id][1] > 0
    if count and (slews or int(actuator.dyntype[0]) == int(mj.mjtDyn.mjDYN_FILTEREXACT)):
        data.act[address] = command
    if getattr(model, "actuator_delay", np.zeros(model.nu))[actuator.id] > 0:
        samples = int(model.actuator_history[actuator.id][0])
        times = model.opt.timestep * np.arange(-samples, 0)
        mj.mj_initCtrlHistory(model, data, actuator.id, times, np.full(samples, command))
