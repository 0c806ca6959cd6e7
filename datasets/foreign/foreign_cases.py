"""A case of a foreign plant: servos, what is hidden in them, three recordings of their motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import gear_plant
import mujoco_plant
import numpy as np
import own_plant
import voltage_plant
from bench import JOINTS, RECORDINGS, Load, _log_uniform
from bus import draw_bus, draw_packets
from cases import SAME_JOINT_SHARE, STRAY_SHARE, STRONGEST, WEAKEST, WEAKEST_OF_TWO, _draw_model
from catalogue import EFFECTS, NOMINAL, Scale
from clock import Disturbance, draw_disturbance, empty_cells
from excitation import DURATION_S, signal
from foreign_servos import GEARED, HOBBY, SLOW_LOOP_HZ, ForeignServo, draw_servos
from foreign_world import (
    GRID_S,
    LINK,
    SENSED,
    SHAPED,
    Acting,
    Hidden,
    Take,
    acting_on,
    arrivals,
    recorded,
    seen,
)  # fmt: skip
from numpy.typing import NDArray
from outside import OUTSIDERS, draw_windows

Array = NDArray[np.float64]

RATE_HZ = 30.0, 200.0
ROWS, SHORTEST_S = 1200, 12.0
"""A recording has about so many rows, but lasts no shorter and no longer than ``DURATION_S``."""
CLOCK = 20e-6
"""Largest relative difference between the clocks."""
SMALLEST_COGGING = 8.0
"""Noise levels from which a cogging is an effect rather than a nuisance."""
TRIES = 30

_COMMON = (
    "sensor_offset", "sensor_gain", "sensor_filter", "encoder_quantization", *SHAPED,
    "latency_jitter", "packet_loss", "clock_drift",
)  # fmt: skip
CAN = {
    "mujoco": (
        *_COMMON, "coulomb_friction", "backlash", "compliance", "gravity_load",
        "unmodelled_inertia", "torque_saturation", "quadratic_drag", "deadband",
        "integral_action", "cogging",
    ),
    "voltage": (
        *_COMMON, "coulomb_friction", "stribeck_friction", "asymmetric_friction", "load_friction",
        "quadratic_drag", "deadband", "torque_saturation", "torque_asymmetry", "integral_action",
        "gravity_load", "unmodelled_inertia", "cogging", "thermal_derating", "supply_droop",
    ),
    "own": tuple(EFFECTS),
}  # fmt: skip
"""Effects of the catalogue that each plant can have."""
BACKLASH_WITH_FRICTION = {
    "mujoco": ("backlash_motor_friction", "backlash_output_friction"),
    "voltage": (),
    "own": ("backlash_motor_friction",),
}
"""Single backlashes on benches whose servos have dry friction on the motor's or the output's side.

The friction is a nuisance: a verdict may name it or leave it out."""
OUTSIDE = {
    "mujoco": ("external_push", "vibration", "end_stop", "gain_schedule", "potentiometer",
               "stuck_sensor"),
    "voltage": ("external_push", "vibration", "end_stop", "gain_schedule", "potentiometer",
                "stuck_sensor", "jam", "brown_out"),
    "own": tuple(OUTSIDERS),
}  # fmt: skip
for _of_plant in (CAN, BACKLASH_WITH_FRICTION, OUTSIDE):
    _of_plant.update(dict.fromkeys(GEARED, _of_plant["mujoco"]))
OUTSIDE |= dict.fromkeys(GEARED, (*OUTSIDE["mujoco"], "jam"))
RATTLING = "backlash_rattling"
"""Single backlashes without friction, of loads without weight and damping by the output's speed."""
BACKLASH_WITH_FRICTION[HOBBY] += (RATTLING,)
SIMULATORS = {"mujoco": mujoco_plant, "voltage": voltage_plant} | dict.fromkeys(GEARED, gear_plant)


@dataclass
class ForeignCase:
    """What is recorded and what is hidden in it; fields as those of ``cases.Case``."""

    plant: str
    kind: str
    servos: list[ForeignServo]
    hidden: list[Hidden]
    takes: dict[str, Take]
    trap: str = ""
    disturbed: bool = False
    model: dict[str, dict[str, float]] = field(default_factory=dict)
    model_wrong: bool = False

    def readings(
        self,
        recording: str,
        hidden: Sequence[Hidden] | None = None,
        servos: Sequence[ForeignServo] | None = None,
        which: Sequence[int] | None = None,
        *,
        bent: bool = True,
    ) -> Array:
        """Noise-free readings, rad, shape (T, J); NaN for joints that are not asked for."""
        hidden = self.hidden if hidden is None else hidden
        servos, take = list(servos or self.servos), self.takes[recording]
        which = range(len(servos)) if which is None else which
        acting = [acting_on(hidden, j) for j in range(len(servos))]
        grid = np.arange(0.0, take.t[-1] + 0.05, GRID_S)
        sent = [arrivals(take, j, s.latency_s, a)
                for j, (s, a) in enumerate(zip(servos, acting, strict=True))]  # fmt: skip
        windows = [take.windows if OUTSIDERS.keys() & a.keys() else [] for a in acting]
        body: list[Acting] = [
            {k: v for k, v in a.items() if k not in (*LINK, *SHAPED, *SENSED)} for a in acting
        ]
        out = np.full((take.t.size, len(servos)), np.nan)
        if self.plant == "own":
            angles = own_plant.simulate_all(
                servos, recording, body, grid,
                [w for w, _ in sent], [s for _, s in sent], windows,
            )  # fmt: skip
        for j in which:
            servo, load = servos[j], servos[j].loads[recording]
            if self.plant != "own":
                angle = SIMULATORS[self.plant].simulate(
                    servo, load, body[j], grid, *sent[j], windows[j]
                )
            else:
                angle = angles[j]
            out[:, j] = seen(take, grid, angle, servo, acting[j], bent=bent)
        return out


def draw_case(plant: str, kind: str, name: str, rng: np.random.Generator) -> ForeignCase:
    """A case of a plant and a kind: ``null``, ``trap``, ``single``, ``double`` or ``outside``."""
    servos = draw_servos(plant, rng)
    while name in (*LINK, "voltage_sag", "supply_droop", "neighbour_reaction") and len(servos) < 2:
        servos = draw_servos(plant, rng)
    for servo in servos:
        if name == RATTLING:
            servo.firmware_damping = 1.0
            servo.loads = {k: Load(x.inertia_kgm2) for k, x in servo.loads.items()}
        elif name in BACKLASH_WITH_FRICTION[plant]:
            strength = _log_uniform(rng, WEAKEST_OF_TWO, STRONGEST)
            servo.dry_friction_Nm = strength * NOMINAL["coulomb_friction"]
            servo.friction_on_output = name == "backlash_output_friction"
    bus_rng = rng.spawn(1)[0]
    bus = draw_bus(bus_rng)
    stray = rng.random() < STRAY_SHARE and kind not in ("null", "trap")
    rate = float(RATE_HZ[0] * (RATE_HZ[1] / RATE_HZ[0]) ** rng.random())
    takes, lasts = {}, float(np.clip(ROWS / rate, SHORTEST_S, DURATION_S))
    for recording in RECORDINGS:
        t = _ticks(rate, lasts, draw_disturbance(rng) if stray or name == "clock" else None, rng)
        command = np.stack([np.round(signal(recording, t, rng, lasts), 4) for _ in servos], axis=1)
        clock = float(rng.uniform(-CLOCK, CLOCK))
        takes[recording] = Take(t, command, draw_packets(bus, t.size, len(servos), bus_rng), clock)
    disturbed = stray or name == "clock"
    case = ForeignCase(plant, kind, servos, [], takes, name if kind == "trap" else "", disturbed)
    if kind in ("single", "double"):
        scales = _scales(case)
        if kind == "single":
            joint = int(rng.integers(len(servos)))
            effect = "backlash" if name in BACKLASH_WITH_FRICTION[plant] else name
            case.hidden = [_draw(case, effect, joint, WEAKEST, scales, rng)]
        else:
            case.hidden = _draw_pair(case, scales, rng)
    elif kind == "outside" and not _hide_outsider(case, name, rng):
        return draw_case(plant, kind, name, rng)
    given = rng.random() < STRAY_SHARE and kind not in ("null", "trap")
    if given or name == "wrong_parameters":
        case.model_wrong = bool(rng.random() < 0.5) or name == "wrong_parameters"
        case.model = _draw_model(servos, wrong=case.model_wrong, rng=rng)
    for recording, take in takes.items():
        readings = case.readings(recording)
        if not np.isfinite(readings).all() or np.abs(readings).max() > 2.5:
            return draw_case(plant, kind, name, rng)  # a servo that is not stable
        take.measured = np.stack(
            [recorded(take, readings[:, j], s, acting_on(case.hidden, j), rng)
             for j, s in enumerate(servos)], axis=1,
        )  # fmt: skip
        if disturbed:
            take.measured[empty_cells(take.measured.shape, rng)] = np.nan
    return case


def _ticks(
    rate: float, lasts_s: float, disturbance: Disturbance | None, rng: np.random.Generator
) -> Array:
    """Times of samples, s: honest, in good order or in disorder."""
    ticks = np.arange(int(lasts_s * rate) + 1)
    jitter = 0.2e-3
    if disturbance is not None:
        jitter = min(disturbance.jitter_sd_s, 0.15 / rate)
        out = rng.integers(60, ticks.size - 60, size=disturbance.single_rows)
        for _ in range(disturbance.gaps):
            start = int(rng.integers(60, ticks.size - 60))
            out = np.concatenate([out, start + np.arange(int(rng.integers(4, 30)))])
        ticks = np.delete(ticks, np.unique(out))
    shift = np.clip(rng.normal(0.0, jitter, size=ticks.size), -0.4 / rate, 0.4 / rate)
    t = ticks / rate + shift
    return np.round(t - t[0], 5)


def _scales(case: ForeignCase) -> list[Scale]:
    """What sizes are measured by: torque as it was without anything hidden."""
    readings = case.readings("a", [], bent=False)
    scales = []
    for j, servo in enumerate(case.servos):
        take = case.takes["a"]
        target = np.interp(take.t - servo.latency_s, take.t, take.command[:, j])
        speed = np.gradient(readings[:, j], take.t)
        pull = np.clip(servo.kp * (target - readings[:, j]), -servo.stall_Nm, servo.stall_Nm)
        torque = pull - servo.kd * speed
        square = float(np.mean(torque**2))
        if case.plant == "own":
            fields = servo.fields("a")
            square /= (fields["gear_ratio"] * fields["torque_constant"]) ** 2
        peak = min(float(np.max(np.abs(torque))), servo.stall_Nm)
        least = min(s.latency_s for s in case.servos)
        scales.append(Scale(servo, peak, square, least))
    return scales


def _draw(
    case: ForeignCase, name: str, joint: int, weakest: float, scales: list[Scale],
    rng: np.random.Generator,
) -> Hidden:  # fmt: skip
    strength = float(weakest * (STRONGEST / weakest) ** rng.random())
    return sized(case, name, joint, strength, scales[joint], rng.random(3))


def sized(
    case: ForeignCase, name: str, joint: int, strength: float, scale: Scale, shape: Array
) -> Hidden:
    """An effect of the catalogue at a strength and a shape (3,)."""
    effect = EFFECTS[name]
    parameters = effect.draw(strength, scale, shape)
    if name == "cogging":
        servo = case.servos[joint]
        least = SMALLEST_COGGING * servo.noise_rad * servo.kp
        parameters["torque_Nm"] = max(parameters["torque_Nm"], least)
    own = effect.place == "joint" or (name == "supply_droop" and case.plant == "voltage")
    return Hidden(
        name,
        JOINTS[joint] if effect.place == "joint" else effect.place,
        parameters,
        strength,
        effect.driver,
        joint if own and effect.place == "joint" else None,
    )


def _draw_pair(case: ForeignCase, scales: list[Scale], rng: np.random.Generator) -> list[Hidden]:
    n = len(case.servos)
    same = rng.random() < SAME_JOINT_SHARE or n < 2
    names = [x for x in CAN[case.plant] if EFFECTS[x].place == "joint" or not same]
    while True:
        pair = [str(x) for x in rng.choice(names, size=2, replace=False)]
        first, second = (EFFECTS[x] for x in pair)
        if same and first.family and first.family == second.family:
            continue
        if first.place != "joint" and second.place != "joint":
            continue
        break
    joints = rng.permutation(n)[:2]
    if same:
        joints = np.repeat(joints[:1], 2)
    return [
        _draw(case, x, int(j), WEAKEST_OF_TWO, scales, rng)
        for x, j in zip(pair, joints, strict=True)
    ]


def _hide_outsider(case: ForeignCase, name: str, rng: np.random.Generator) -> bool:
    """Draw until it shows above noise and nuisances, in every window or over the whole."""
    kind = OUTSIDERS[name]
    for _ in range(TRIES if case.plant == "own" else TRIES // 3):
        joint = int(rng.integers(len(case.servos)))
        parameters = kind.draw(list(case.servos), joint, rng)
        case.hidden = [Hidden(name, JOINTS[joint], parameters, 1.0, kind.driver, joint)]
        for recording, windows in draw_windows(kind, rng).items():
            last = float(case.takes[recording].t[-1])
            case.takes[recording].windows = [
                (a * last / DURATION_S, b * last / DURATION_S) for a, b in windows
            ]
        if _shows(case, joint):
            return True
    return False


def _shows(case: ForeignCase, joint: int) -> bool:
    servo = case.servos[joint]
    small = [servo.noise_rad, servo.eccentric[0] / 2, servo.nuisances["ripple_Nm"] / servo.kp / 2]
    floor = 3 * float(np.sqrt(np.sum(np.square(small))))
    always = OUTSIDERS[case.hidden[0].effect].lasts_s is None
    for recording in ("a", "b"):
        take = case.takes[recording]
        without = case.readings(recording, [], which=[joint])[:, joint]
        reading = case.readings(recording, which=[joint])[:, joint]
        if case.hidden[0].effect == "stuck_sensor":
            from sensor import stick

            reading = stick(reading, take.t, take.windows)
        for start, stop in [(0.0, np.inf)] if always else take.windows:
            inside = (take.t >= start) & (take.t < stop)
            if not inside.any() or np.sqrt(np.mean((reading - without)[inside] ** 2)) < floor:
                return False
    return True


def nuisances(case: ForeignCase) -> list[dict[str, Any]]:
    """What every servo here has a little of, that the catalogue has a name for."""
    found = []
    for servo, joint in zip(case.servos, JOINTS, strict=False):
        n = servo.nuisances
        size = {"torque_Nm": n["ripple_Nm"], "period_rad": 2 * np.pi / n["ripple_per_rad"]}
        found.append({"effect": "cogging", "component": joint, "parameters": size})
        if servo.dry_friction_Nm:
            friction = {"torque_Nm": servo.dry_friction_Nm}
            found.append({"effect": "coulomb_friction", "component": joint, "parameters": friction})
    waits = [0.5 / s.loop_Hz for s in case.servos if s.loop_Hz >= SLOW_LOOP_HZ]
    if case.plant != "own" and waits:
        # A new set-point waits for the next turn of the loop.
        late = {"halfwidth_s": max(waits)}
        found.append({"effect": "latency_jitter", "component": "link", "parameters": late})
    return found


def with_gains(servo: ForeignServo, offsets: Array) -> ForeignServo:
    """A servo whose gains and latency are off: log kp, log kd and latency in 10 ms, shape (3,)."""
    return replace(
        servo,
        kp=servo.kp * float(np.exp(offsets[0])),
        kd=servo.kd * float(np.exp(offsets[1])),
        latency_s=max(servo.latency_s + 0.01 * float(offsets[2]), 0.0),
    )
