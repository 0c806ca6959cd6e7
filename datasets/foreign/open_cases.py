"""Benches of one servo that a short, gentle recording leaves open.

One or two effects are hidden, of families whose members look alike, at moderate sizes: in the first
recording one who knows the plant (``knower``) prefers the truth to a servo without the effect by
some tens to hundreds of nats, which is 5 to 50 % of the error of about 500 samples. Of two effects
the second may be smaller. Sizes follow from the plant alone, not from any diagnosis.
"""

from __future__ import annotations

from collections.abc import Sequence

import knower
import numpy as np
from bus import draw_bus, draw_packets
from cases import STRONGEST
from catalogue import EFFECTS
from foreign_cases import CAN, CLOCK, ForeignCase, _scales, _ticks, sized
from foreign_servos import PLANTS, draw_servos
from foreign_world import Take, acting_on, recorded
from numpy.typing import NDArray

Array = NDArray[np.float64]

FAMILIES = {
    "delay": ("clock_drift", "compliance", "command_filter", "sensor_filter", "rate_limit",
              "acceleration_limit"),
    "strength": ("voltage_sag", "supply_droop", "thermal_derating", "torque_saturation",
                 "torque_asymmetry", "sensor_gain"),
    "gap": ("backlash", "presliding_friction", "coulomb_friction", "stribeck_friction",
            "asymmetric_friction", "load_friction", "deadband"),
    "load": ("unmodelled_inertia", "gravity_load", "compliance", "sensor_gain"),
    "speed": ("quadratic_drag", "rate_limit", "torque_saturation", "load_friction"),
    "place": ("gravity_load", "sensor_offset", "integral_action", "cogging", "sensor_gain"),
}  # fmt: skip
"""Effects that are easily taken for one another."""
FIRST_S = 8.0, 10.0
"""Duration of the first recording, s."""
RATE_HZ = 40.0, 100.0
REACH_RAD = 0.08, 0.4
"""Amplitude of the first recording, rad."""
HELD_OUT_S = 12.0
NATS = 40.0, 300.0
"""Log-likelihood ratio of a hidden effect in the first recording."""
SMALLER_NATS = 8.0, 80.0
"""That of the second of two."""
DOUBLES = 0.4
"""Share of benches with two effects."""
ROUNDS = 3
"""Rounds in which sizes are set; a ratio of log-likelihoods grows about as their square."""


def draw_open_case(rng: np.random.Generator) -> ForeignCase:
    """A bench with its recordings ``a``, gentle, and ``c``, held out; ``b`` is yet to be made."""
    while True:
        plant = PLANTS[int(rng.integers(len(PLANTS)))]
        case = ForeignCase(plant, "", draw_servos(plant, rng)[:1], [], {})
        names = _draw_names(plant, rng)
        case.kind = "single" if len(names) == 1 else "double"
        bus, rate = draw_bus(rng), float(rng.uniform(*RATE_HZ))
        for recording, lasts in (("a", rng.uniform(*FIRST_S)), ("c", HELD_OUT_S)):
            t = _ticks(rate, float(lasts), None, rng)
            command = gentle(t, rng) if recording == "a" else _held_out(t, rng)
            packets = draw_packets(bus, t.size, 1, rng)
            clock = float(rng.uniform(-CLOCK, CLOCK))
            case.takes[recording] = Take(t, np.round(command, 4)[:, None], packets, clock)
        if _hide(case, names, rng):
            return case


def gentle(t: Array, rng: np.random.Generator) -> Array:
    """Set-points of a first recording at the times ``t`` (T,): one shape, one size, one speed."""
    size = REACH_RAD[0] * (REACH_RAD[1] / REACH_RAD[0]) ** rng.random()
    hz, kind = 0.3 * 4.0 ** rng.random(), int(rng.integers(4))
    phase = hz * np.maximum(t - 0.8, 0.0)
    wave = (
        np.sin(2 * np.pi * phase),
        1 - 4 * np.abs((phase + 0.25) % 1 - 0.5),
        np.sign(np.sin(2 * np.pi * phase)),
        np.sin(2 * np.pi * phase) * np.sin(2 * np.pi * 0.37 * phase),
    )[kind]
    moving = (t > 0.8) & (t < t[-1] - 0.8)
    return np.where(moving, size * wave, 0.0)


def _held_out(t: Array, rng: np.random.Generator) -> Array:
    """Steps and sines of all sizes."""
    level = rng.uniform(-0.8, 0.8, int(t[-1]) + 2)[t.astype(int)]
    wave = 0.4 * np.sin(2 * np.pi * (0.2 + 0.1 * t) * t)
    return np.where(t < t[-1] / 2, level, wave)


def _draw_names(plant: str, rng: np.random.Generator) -> list[str]:
    """One effect, or two that do not share a mechanism, half of them of one family."""
    shared = ("clock_drift", "supply_droop", "voltage_sag")
    can = [n for n in CAN[plant] if EFFECTS[n].place == "joint" or n in shared]
    families = [[n for n in family if n in can] for family in FAMILIES.values()]
    first = families[int(rng.integers(len(families)))]
    if rng.random() >= DOUBLES:
        return [str(rng.choice(first))]
    second = first if rng.random() < 0.5 else families[int(rng.integers(len(families)))]
    while True:
        one, other = str(rng.choice(first)), str(rng.choice(second))
        mechanism = EFFECTS[one].family
        if one != other and not (mechanism and mechanism == EFFECTS[other].family):
            return [one, other]
        second = families[int(rng.integers(len(families)))]


def _hide(case: ForeignCase, names: Sequence[str], rng: np.random.Generator) -> bool:
    """Hide effects at the wanted ratios of likelihoods; whether the servo is stable and they show.

    The noise is drawn once, so that sizes change only what it is added to.
    """
    scales, shape = _scales(case), rng.random((len(names), 3))
    low, high = np.transpose([NATS, SMALLER_NATS][: len(names)])
    wanted = low * (high / low) ** rng.random(len(names))
    strength, noise = np.exp(rng.normal(-0.5, 0.3, len(names))), int(rng.integers(2**32))
    for k in range(ROUNDS):
        given = zip(names, strength.tolist(), shape, strict=True)
        case.hidden = [sized(case, n, 0, s, scales[0], u) for n, s, u in given]
        if not _record(case, np.random.default_rng(noise)):
            return False
        told = knower.consult(case, ["a"])
        ratio = np.array([*told.get("llr_of_each", {"": told["llr_total"]}).values()])
        if k < ROUNDS - 1:
            strength = strength * np.clip(np.sqrt(wanted / np.maximum(ratio, 0.1)), 0.3, 3.0)
            strength = np.clip(strength, 0.03, STRONGEST)
    return bool(np.max(ratio) >= NATS[0] / 2)


def _record(case: ForeignCase, rng: np.random.Generator) -> bool:
    """Make both recordings; whether their angles are finite and small."""
    for name, take in case.takes.items():
        reading = case.readings(name)[:, 0]
        if not np.isfinite(reading).all() or np.abs(reading).max() > 2.5:
            return False
        take.measured = recorded(take, reading, case.servos[0], acting_on(case.hidden, 0), rng)[
            :, None
        ]
    return True
