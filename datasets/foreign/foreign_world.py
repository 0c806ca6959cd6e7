"""What all plants have in common: the link to them, shaped set-points, the chain of the sensor."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from bus import Packets
from foreign_servos import SLOW_LOOP_HZ
from numpy.typing import NDArray
from scipy.signal import lfilter
from sensor import noise, quantize, stick

Array = NDArray[np.float64]
Acting = dict[str, dict[str, float]]
"""Effects that act on one servo, with their parameters."""
Window = tuple[float, float]

GRID_S = 1e-3
SHAPING_S = 2.5e-4
LINK = ("latency_jitter", "packet_loss", "clock_drift")
SHAPED = ("command_filter", "rate_limit", "acceleration_limit")
SENSED = (
    "sensor_offset", "sensor_gain", "sensor_filter", "encoder_quantization",
    "potentiometer", "stuck_sensor",
)  # fmt: skip
SHARED = ("supply", "link")
FIELDS_OF = {  # effect: field of a plant by parameter
    "coulomb_friction": {"dry": "torque_Nm"},
    "stribeck_friction": {
        "dry": "torque_Nm",
        "breakaway": "breakaway_Nm",
        "slow": "velocity_rad_s",
    },
    "asymmetric_friction": {"dry": "torque_Nm", "asymmetric": "asymmetry"},
    "load_friction": {"of_load": "ratio"},
    "quadratic_drag": {"drag": "coefficient_Nms2"},
    "deadband": {"dead": "halfwidth_rad"},
    "torque_saturation": {"limit": "limit_Nm"},
    "torque_asymmetry": {"lopsided": "asymmetry"},
    "integral_action": {"integral": "ki_Nm_per_rad_s"},
    "gravity_load": {"weight": "torque_Nm"},
    "cogging": {"cog": "torque_Nm", "cog_period": "period_rad", "cog_phase": "phase_rad"},
    "thermal_derating": {"heat_loss": "loss", "heat_ref": "_reference_A2"},
    "supply_droop": {"droop": "loss_per_min"},
    "external_push": {"push": "push_Nm"},
    "jam": {"jam": "jam_Nm"},
    "vibration": {"shake": "shake_Nm", "shake_Hz": "shake_Hz", "shake_phase": "shake_phase"},
    "end_stop": {"stop": "stop_rad", "stop_side": "stop_side", "stop_k": "stop_Nm_per_rad"},
    "gain_schedule": {"schedule": "schedule_rad", "schedule_by": "schedule_factor"},
    "backlash": {"gap": "gap_rad"},
}


@dataclass(frozen=True)
class Hidden:
    """A hidden effect, as the answers say it; ``joint`` is None where it acts on all."""

    effect: str
    component: str
    parameters: dict[str, float]
    strength: float
    driver: str
    joint: int | None


@dataclass
class Take:
    """One recording: T samples of J joints; times in s, angles in rad.

    ``packets`` carry the set-points. ``clock`` is how much faster the clock of the sensors runs,
    relative to that of the set-points.
    """

    t: Array
    command: Array
    packets: Packets
    clock: float
    windows: list[Window] = field(default_factory=list)
    measured: Array = field(default_factory=lambda: np.empty((0, 0)))


def acting_on(hidden: Sequence[Hidden], joint: int) -> Acting:
    """The effects on one joint, those that all share included."""
    return {h.effect: h.parameters for h in hidden if h.joint is None or h.joint == joint}


def deliveries(
    take: Take, joint: int, latency_s: float, acting: Acting
) -> tuple[NDArray[np.intp], Array]:
    """Indices of the set-points that a joint receives, in order of arrival, and when, s."""
    jitter = acting.get("latency_jitter", {}).get("halfwidth_s", 0.0) / np.sqrt(3)
    drift = acting.get("clock_drift", {}).get("s_per_s", 0.0)
    lost = acting.get("packet_loss", {}).get("probability", 0.0)
    late = latency_s + drift * take.t + jitter * take.packets.delay[:, joint]
    return take.packets.delivered(take.t + np.maximum(late, 0.0), joint, lost)


def arrivals(take: Take, joint: int, latency_s: float, acting: Acting) -> tuple[Array, Array]:
    """When set-points take effect, s, and what is then in force, rad."""
    received, arrival = deliveries(take, joint, latency_s, acting)
    return _shaped(arrival, take.command[received, joint], acting)


def held(arrival: Array, setpoint: Array, times: Array) -> Array:
    """The set-point in force at each time; the first before any has arrived."""
    k = np.searchsorted(arrival, times + 1e-9, side="right") - 1
    return np.asarray(setpoint[np.maximum(k, 0)])


def fields_of(acting: Acting) -> dict[str, float]:
    """Fields of a plant that effects set."""
    fields: dict[str, float] = {}
    for effect, parameters in acting.items():
        for name, parameter in FIELDS_OF.get(effect, {}).items():
            fields[name] = parameters[parameter]
    return fields


def marched(
    march: Callable[..., Array], row: Array, step_s: float, loop_Hz: float, grid: Array,
    arrivals: Array, setpoints: Array, windows: Sequence[Window],
) -> Array:  # fmt: skip
    """Angles in rad at the times ``grid`` (T,) of a plant with these fields, in steps."""
    times = np.arange(int(np.ceil(grid[-1] / step_s)) + 1) * step_s
    inside = np.zeros(times.size)
    for a, b in windows:
        inside[(times >= a) & (times < b)] = 1.0
    turn = max(1, round(1 / (loop_Hz * step_s)))
    angle = march(row, held(arrivals, setpoints, times), inside, turn, loop_Hz < SLOW_LOOP_HZ)
    return np.interp(grid, times, angle)


def _shaped(arrival: Array, setpoint: Array, acting: Acting) -> tuple[Array, Array]:
    """Set-points as the controller's own profile makes them."""
    if not set(acting) & set(SHAPED):
        return arrival, setpoint
    times = np.arange(0.0, arrival[-1] + 0.2, SHAPING_S)
    raw = held(arrival, setpoint, times)
    if "command_filter" in acting:
        keep = float(np.exp(-SHAPING_S / acting["command_filter"]["time_constant_s"]))
        return times, np.asarray(lfilter([1 - keep], [1, -keep], raw))
    if "rate_limit" in acting:
        return times, _limited(raw, acting["rate_limit"]["limit_rad_s"] * SHAPING_S)
    return times, _accelerated(raw, acting["acceleration_limit"]["limit_rad_s2"])


def _limited(raw: Array, most: float) -> Array:
    out, now = np.empty(raw.size), float(raw[0])
    for k, wanted in enumerate(raw.tolist()):
        now += min(max(wanted - now, -most), most)
        out[k] = now
    return out


def _accelerated(raw: Array, most: float) -> Array:
    """To rest at the set-point in the shortest time: full acceleration, then full braking."""
    out, now, speed, h = np.empty(raw.size), float(raw[0]), 0.0, SHAPING_S
    for k, wanted in enumerate(raw.tolist()):
        away = wanted - now
        if abs(away) < most * h * h and abs(speed) < most * h:
            now, speed = wanted, 0.0
        else:
            best = np.sqrt(2 * most * abs(away)) * (1 if away > 0 else -1)
            speed += min(max(best - speed, -most * h), most * h)
            now += h * speed
        out[k] = now
    return out


def seen(
    take: Take, grid: Array, angle: Array, servo: object, acting: Acting, *, bent: bool
) -> Array:
    """What the sensor reads without noise, rad, shape (T,), of the angle (G,) on ``grid``."""
    if "sensor_filter" in acting:
        keep = float(np.exp(-GRID_S / acting["sensor_filter"]["time_constant_s"]))
        angle = np.asarray(lfilter([1 - keep], [1, -keep], angle))
    when = take.t * (1 + take.clock) + servo.read_s  # type: ignore[attr-defined]
    q = np.interp(when, grid, angle)
    reading = q + servo.bent(q) if bent else q.copy()  # type: ignore[attr-defined]
    reading = acting.get("sensor_gain", {}).get("gain", 1.0) * reading
    reading += acting.get("sensor_offset", {}).get("offset_rad", 0.0)
    if "potentiometer" in acting:
        p = acting["potentiometer"]
        reading += p.get("bend_per_rad", 0.0) * q**2
        turned = 2 * np.pi * q / p.get("bump_period_rad", 1.0) + p.get("bump_phase_rad", 0.0)
        reading += p.get("bump_rad", 0.0) * np.sin(turned)
    return reading


def recorded(take: Take, reading: Array, servo: object, acting: Acting, rng: object) -> Array:
    """A reading with its noise, rounded; stuck in the windows where the sensor sticks."""
    sensor = servo.sensor  # type: ignore[attr-defined]
    step = acting.get("encoder_quantization", {}).get("step_rad", sensor.step_rad)
    angle = quantize(reading + noise(sensor, take.t, rng), step)  # type: ignore[arg-type]
    return stick(angle, take.t, take.windows) if "stuck_sensor" in acting else angle
