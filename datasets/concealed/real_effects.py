"""Effects of the catalogue that can be put into a real log exactly, where its sensor or link is.

Where the sensor reads: ``sensor_gain``, ``sensor_offset``, ``sensor_filter``,
``encoder_quantization`` (2 to 8 steps), ``clock_drift`` (measured angles come later and later;
positive only). Where commands are sent: ``command_filter`` (recorded set-points are those whose
filtered version really arrived; only where the command starts gently) and ``latency_jitter`` (each
is the one that really arrived when the jitter had passed; within half a sample, so that none
overtakes: faint). Play, friction and all else that acts on the motion can't be put in exactly.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from backgrounds import Log, Rng, rate, rms

Parameters = dict[str, Any]


@dataclass(frozen=True)
class Change:
    """Something that can be put into a log.

    Attributes:
        driver: What decides its size from moment to moment.
        families: Logs that it can be put into.
        draw: Parameters for a change of about ``size`` rad of a log's joint.
        put: The log with it.
        component: ``link``, or empty for the joint.
        lasts_s: Shortest and longest window in s; None where it always acts, infinite where it
            stays to the end.
    """

    driver: str
    families: tuple[str, ...]
    draw: Callable[[Log, int, float, Rng], Parameters]
    put: Callable[[Log, int, Parameters, Rng], Log]
    component: str = ""
    lasts_s: tuple[float, float] | None = None


def signed(size: float, rng: Rng) -> float:
    """Either sign."""
    return float(size * rng.choice([-1.0, 1.0]))


def _gain(log: Log, j: int, p: Parameters, _: Rng) -> Log:
    return log.reads(j, p["gain"] * log.position[:, j])


def _offset(log: Log, j: int, p: Parameters, _: Rng) -> Log:
    return log.reads(j, log.position[:, j] + p["offset_rad"])


def _filter(log: Log, j: int, p: Parameters, _: Rng) -> Log:
    """First order, at rest at first; exact for an angle that is straight between samples."""
    tau, angle = p["time_constant_s"], log.position[:, j]
    slow = angle.copy()
    for k, dt in enumerate(np.diff(log.t)):
        lag = tau * (angle[k + 1] - angle[k]) / dt
        slow[k + 1] = angle[k + 1] - lag + (slow[k] - angle[k] + lag) * np.exp(-dt / tau)
    return log.reads(j, slow)


def _quantize(log: Log, j: int, p: Parameters, _: Rng) -> Log:
    return log.reads(j, np.round(log.position[:, j] / p["step_rad"]) * p["step_rad"])


def _drift(log: Log, j: int, p: Parameters, _: Rng) -> Log:
    return log.reads(j, np.interp(log.t / (1 + p["s_per_s"]), log.t, log.position[:, j]))


def _unfilter(log: Log, j: int, p: Parameters, _: Rng) -> Log:
    """The set-points that a first-order filter turns into the real ones."""
    command = log.command[:, j]
    sent = command + p["time_constant_s"] * rate(command, log.t)
    sent[0] = command[0]
    return log.sends(j, sent)


def _jitter(log: Log, j: int, p: Parameters, rng: Rng) -> Log:
    late = rng.uniform(-p["halfwidth_s"], p["halfwidth_s"], size=log.t.size)
    late[0] = 0.0
    return log.sends(j, np.interp(log.t + late, log.t, log.command[:, j]))


ALL, SMOOTH = ("xl330", "sts", "emps"), ("xl330", "emps")
SIZE_RAD = {"xl330": 1e-3, "sts": 1.5e-3, "emps": 2e-5}
EFFECTS = {  # in the order in which two of them are put in
    "command_filter": Change(
        "command", SMOOTH,
        lambda g, j, size, rng: {
            "time_constant_s": min(size / rms(rate(g.command[:, j], g.t)), 0.08)
        },
        _unfilter,
    ),
    "latency_jitter": Change(
        "command", SMOOTH,
        lambda g, j, size, rng: {
            "halfwidth_s": float(np.median(np.diff(g.t)) * 0.5 * 0.1 ** rng.uniform())
        },
        _jitter, "link",
    ),
    "sensor_gain": Change(
        "position", ALL,
        lambda g, j, size, rng: {"gain": 1 + signed(size / rms(g.position[:, j]), rng)},
        _gain,
    ),
    "sensor_offset": Change(
        "none", ALL, lambda g, j, size, rng: {"offset_rad": signed(size, rng)}, _offset
    ),
    "sensor_filter": Change(
        "speed", SMOOTH,
        lambda g, j, size, rng: {
            "time_constant_s": min(size / rms(rate(g.position[:, j], g.t)), 0.08)
        },
        _filter,
    ),
    "clock_drift": Change(
        "time", SMOOTH,
        lambda g, j, size, rng: {
            "s_per_s": min(size / rms(g.t * rate(g.position[:, j], g.t)), 0.02)
        },
        _drift, "link",
    ),
    "encoder_quantization": Change(
        "none", ("xl330", "sts"),
        lambda g, j, size, rng: {"step_rad": g.step * int(rng.integers(2, 9))},
        _quantize,
    ),
}  # fmt: skip
