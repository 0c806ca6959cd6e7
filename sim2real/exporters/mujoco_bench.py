"""Run an exported MuJoCo model on commands; holds them back itself where MuJoCo can't."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim2real.errors import InputError

Array = NDArray[np.float64]


def simulate(
    xml: str,
    t: Array,
    command: Mapping[str, Array],
    start: Mapping[str, float] | None = None,
) -> dict[str, Array]:
    """Angles that the sensors of an exported model measure on commands.

    A set-point takes effect a latency after its time: by the actuator's ``delay`` where this
    version of MuJoCo has that, else because it is written to ``ctrl`` only then. The model comes
    from rest on the first set-points.

    Args:
        xml: The model, as `mujoco.mujoco` writes it.
        t: Times in s, shape (T,), increasing.
        command: Set-points in rad by joint, each of shape (T,); NaN is not understood.
        start: Angle in rad at which a joint rests on its first set-point; that set-point itself
            where a joint has none here.

    Returns:
        Angles in rad by joint, each of shape (T,).

    Raises:
        InputError: If MuJoCo is not installed or the model lacks a joint.
    """
    try:
        import mujoco as mj
    except ImportError:
        expected = "MuJoCo: pip install 'sim2real[mujoco]'"
        raise InputError("mujoco", "", "no such package", expected) from None
    model = mj.MjModel.from_xml_string(xml)
    data = mj.MjData(model)
    known = [model.sensor(k).name.removesuffix("_position") for k in range(model.nsensor)]
    for joint in command:
        if joint not in known:
            raise InputError("commands", joint, "no such joint", f"one of {', '.join(known)}")
    step = model.opt.timestep
    since = (t - t[0]) / step
    last = math.ceil(since[-1])
    controls = {}
    for joint, values in command.items():
        sent = np.rint(since + _held_back(model, joint, step)).astype(int)
        controls[_input(model, joint)] = _at_every_tick(sent, np.asarray(values, float), last + 1)
        _rest(mj, model, data, joint, float(values[0]), (start or {}).get(joint))
    sensors = {joint: model.sensor(f"{joint}_position").adr[0] for joint in command}
    angles = {joint: np.empty(last + 1) for joint in command}
    for tick in range(last + 1):
        for index, values in controls.items():
            data.ctrl[index] = values[tick]
        mj.mj_step1(model, data)
        for joint, address in sensors.items():
            angles[joint][tick] = data.sensordata[address]
        mj.mj_step2(model, data)
    ticks = np.arange(last + 1)
    return {joint: np.interp(since, ticks, values) for joint, values in angles.items()}


def _input(model: Any, joint: str) -> int:  # noqa: ANN401 - MuJoCo's own types
    """Where the set-point of a joint stands in ``ctrl``."""
    actuator = model.actuator(joint).id
    addresses = getattr(model, "actuator_ctrladr", None)
    return int(actuator if addresses is None else addresses[actuator])


def _held_back(model: Any, joint: str, step: float) -> float:  # noqa: ANN401
    """Ticks to hold the commands of a joint back: what the model itself does not, to a tick."""
    # The integrator moves with the speed at the end of a step: half a step ahead of time.
    ticks = float(model.numeric(f"{joint}_latency_s").data[0]) / step
    delays = getattr(model, "actuator_delay", None)
    if delays is not None and delays[model.actuator(joint).id] > 0:
        return ticks - math.ceil(ticks - 1e-6) + 0.5
    return ticks + 0.5


def _at_every_tick(at: NDArray[np.int_], values: Array, ticks: int) -> Array:
    """The set-point in force at each tick, the first before any; shape (ticks,)."""
    last = np.searchsorted(at, np.arange(ticks), side="right") - 1
    return values[np.maximum(last, 0)]


def _rest(
    mj: Any,  # noqa: ANN401
    model: Any,  # noqa: ANN401
    data: Any,  # noqa: ANN401
    joint: str,
    command: float,
    angle: float | None,
) -> None:
    """Put a joint to rest on its first set-point, with all that the actuator remembers."""
    place = model.joint(joint).qposadr[0]
    data.qpos[place] = model.qpos0[place] + (command if angle is None else angle)
    actuator = model.actuator(joint)
    # A filter or a rate limit remembers its set-point; an integral, which comes last, starts at 0.
    address, count = int(actuator.actadr[0]), int(actuator.actnum[0])
    slews = model.actuator_dynprm[actuator.id][1] > 0
    if count and (slews or int(actuator.dyntype[0]) == int(mj.mjtDyn.mjDYN_FILTEREXACT)):
        data.act[address] = command
    if getattr(model, "actuator_delay", np.zeros(model.nu))[actuator.id] > 0:
        samples = int(model.actuator_history[actuator.id][0])
        times = model.opt.timestep * np.arange(-samples, 0)
        mj.mj_initCtrlHistory(model, data, actuator.id, times, np.full(samples, command))
