"""Tier T3: real recordings in which something was really changed, and concealed.

``intervention`` says which:

- ``gain``: references at one firmware gain, ``a`` and ``c`` at the other. ``changed`` is kp of
  j1.
- ``torque_off``: the torque is off from 2 s to the end (it never comes back in these logs); the
  set-point column goes on with its last value, and of the faster samples after that two of three
  stay. The recordings are two; four cases differ in where they end. ``c`` has its torque on.
- ``supply``: the supply's voltage is hidden. No references: what is missing altogether? The
  channel shows the sag asked for (slope of voltage on duty, circular shifts at least as steep in
  less than 1 of 100), but there is more in these servos: ``exclusive`` is false. The sag is 1.6
  to 4 % at full duty with R2 below 0.1; gain 200 fails the test. ``measured`` has the numbers.
- ``load``: the stated load of ``a`` and ``c`` is wrong, that of the references right:
  pendulum too light or too heavy by 20 to 60 % or left out (``gravity_load``), or inertia
  (``unmodelled_inertia``). Negative where too much was stated.
- ``none``: another trajectory at the same gain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from backgrounds import Array, Log, Rng
from injections import answer_of
from real_effects import Parameters

GRAVITY_M_S2 = 9.80665


def sag(log: Log, rng: Rng) -> dict[str, float]:
    """Slope of the supply on the duty, and how often a shifted duty gives one as steep."""
    duty = np.abs(log.duty)

    def fit(x: Array) -> tuple[float, float]:
        slope, level = np.polyfit(x, log.supply_V, 1)
        return float(slope), float(level)

    slope, level = fit(duty)
    shifts = rng.integers(20, duty.size - 20, size=500)
    steep = [fit(np.roll(duty, int(k)))[0] <= slope for k in shifts]
    return {
        "loss_at_full_load": -slope / level,
        "at_rest_V": level,
        "r2": float(np.corrcoef(duty, log.supply_V)[0, 1] ** 2),
        "p": float(np.mean(steep)),
        "lowest_V": float(log.supply_V.min()),
    }


def concealed(groups: dict[str, list[Log]], rng: Rng) -> list[Any]:
    """Cases of T3 in random order: recordings by name, and the answer."""
    gains = {200: groups["xl330_200"], 800: groups["xl330_800"]}
    cases = []
    for gain, logs in gains.items():
        other = gains[1000 - gain]
        for k in range(3):
            x, y, z = (int(i) for i in np.roll(np.arange(3), k))
            takes = {"ref_1": logs[x], "ref_2": logs[3], "a": other[y], "c": other[z]}
            changed = {"component": "j1", "parameter": "kp", "factor": (1000 - gain) / gain}
            told = _truth("intervention", "gain", takes, note="changed: kp", changed=changed)
            cases.append((takes, told))
            measured = {"a": sag(logs[y], rng), "b": sag(logs[z], rng)}
            if max(one["p"] for one in measured.values()) < 0.01:
                loss = float(np.mean([one["loss_at_full_load"] for one in measured.values()]))
                effect = _effect("voltage_sag", "supply", {"loss_at_full_load": loss}, "load")
                takes = {"a": logs[y], "b": logs[z], "c": logs[x]}
                note = "hidden: supply_V. Other physics is there too; no references"
                told = _truth("intervention", "supply", takes, [effect], note=note)
                cases.append((takes, told | {"exclusive": False, "measured": measured}))
        for end in (3.6, 6.1):
            x, y, z = (int(i) for i in rng.permutation(3))
            a, start = _hide_off(logs[3], end)
            takes = {"ref_1": logs[x], "ref_2": logs[y], "a": a, "c": logs[z]}
            effect = _effect("torque_off", "j1", {}, "time")
            told = _truth("outside", "torque_off", takes, [effect], note="hidden: torque off")
            cases.append((takes, told | {"windows_s": {"a": [(start, float(a.t[-1]))], "c": []}}))
        for k in range(5):
            cases.append(_wrong_load(logs, k, rng))
        for k in range(4):
            x, y, z = (int(i) for i in np.roll(np.arange(3), -k))
            takes = {"ref_1": logs[x], "ref_2": logs[3], "a": logs[y], "c": logs[z]}
            if k == 3:  # the part of lift_and_drop with its torque on
                on = np.flatnonzero(np.isfinite(logs[3].command[:, 0]))
                takes |= {"ref_2": logs[y], "a": logs[3].rows(on)}
            cases.append((takes, _truth("null", "none", takes)))
    return [cases[i] for i in rng.permutation(len(cases))]


def _hide_off(log: Log, end: float) -> tuple[Log, float]:
    """Up to ``end``, with a set-point throughout and samples as far apart as before."""
    given = np.isfinite(log.command[:, 0])
    off = int(np.argmin(given))
    k = np.arange(log.t.size)
    keep = (log.t < end) & (given | ((k - off) % 3 != 2))
    filled = replace(log, command=np.where(given[:, None], log.command, log.command[off - 1]))
    return filled.rows(np.flatnonzero(keep)), float(log.t[off])


def _wrong_load(logs: list[Log], k: int, rng: Rng) -> Any:
    """Of five: pendulum too light, left out, too heavy; inertia too small, too large."""
    low, high = round(float(rng.uniform(0.4, 0.8)), 2), round(float(rng.uniform(1.2, 1.6)), 2)
    factor = (low, 0.0, high, low, high)[k]
    x, y, z = (int(i) for i in rng.permutation(3))
    load = logs[0].load
    if k < 3:
        field = ("pendulum_mass_kg", "pendulum_length_m")[int(rng.integers(2))]
        torque = GRAVITY_M_S2 * load["pendulum_mass_kg"] * load["pendulum_length_m"]
        effect = _effect("gravity_load", "j1", {"torque_Nm": (1 - factor) * torque}, "position")
    else:
        field = "inertia_kgm2"
        missing = {"inertia_kgm2": (1 - factor) * load[field]}
        effect = _effect("unmodelled_inertia", "j1", missing, "acceleration")
    wrong = load | {field: round(factor * load[field], 6)}
    if factor == 0:
        wrong |= {"pendulum_mass_kg": 0.0, "pendulum_length_m": 0.0}
    takes = {"ref_1": logs[x], "ref_2": logs[3]}
    takes |= {name: replace(logs[i], load=wrong) for name, i in (("a", y), ("c", z))}
    note = f"stated wrong: {field} times {factor:g}"
    return takes, _truth("single", "load", takes, [effect], note=note)


def _effect(name: str, component: str, parameters: Parameters, driver: str) -> Parameters:
    return {
        "effect": name,
        "component": component,
        "parameters": parameters,
        "strength": None,
        "driver": driver,
        "detail": {},
    }


def _truth(
    kind: str,
    intervention: str,
    takes: dict[str, Log],
    effects: Sequence[Parameters] = (),
    note: str = "nothing changed",
    changed: Parameters | None = None,
) -> Parameters:
    """An answer of T3."""
    background = {name: take.name for name, take in takes.items()}
    more = {"intervention": intervention, "note": note, "changed": changed, "exclusive": True}
    return answer_of("T3", kind, [*effects], background, more)
