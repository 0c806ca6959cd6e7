"""Make two sealed sets out of real recordings: changes put into them, and changes really made.

    python datasets/concealed/real.py OUT2 OUT3 --realdata DIR --seed S

Layout and answers are those of ``make.py``, with ``tier`` in each answer. Real servos do more
than a plain PD servo, so a case holds recordings of the same rig as they are, ``ref_1``,
``ref_2``, ...: the solver makes its reference of these and says what else is in ``a`` (and
``b``). A null is *nothing changed*. Recordings hold time, set-points and angles only, sidecars no
metadata.

**Backgrounds.** ``xl330_200`` and ``xl330_800`` (a pendulum at two firmware gains; ``a`` and
``c`` are never ``lift_and_drop``), the four swings of EMPS (metres read as radians, every fourth
sample, each from a turning point), and each STS3215 log cut into stretches of 6 s before the
tested servo steps. Half of the XL330 cases give the three other trajectories as references, so
that ``c`` comes from one of these (``heldout_background`` is ``also a reference``), else ``c`` is
``unseen``. All swings of EMPS have the ``same command``, and repeat within 0.3 um.

**T2, put in.** The truth is exact for angles between the sensor's steps that round to the
recorded ones (a moving mean kept within half a step); the result is rounded again. Where the
sensor reads: ``sensor_gain``, ``sensor_offset``, ``sensor_filter``, ``encoder_quantization`` (2
to 8 steps), ``clock_drift`` (measured angles come later and later; positive only). Where commands
are sent: ``command_filter`` (recorded set-points are those whose filtered version really arrived;
only where the command starts gently) and ``latency_jitter`` (each is the one that really arrived
when the jitter had passed; within half a sample, so that none overtakes: faint). Play, friction
and all else that acts on the motion can't be put in exactly. Outside the catalogue: ``horn_slip``
(an offset from an instant to the end), ``stuck_sensor``, ``potentiometer``, ``sensor_spikes``,
``sensor_dropout`` (holds of a few samples within a window), ``timestamp_glitch`` (angles late
within a window). Traps are nulls with gaps in the clock; a tenth of the other cases has them too.

``strength`` is the root mean square change of ``change_of`` (angle or set-point) over
``noise_rad``, what an autoregression (STS3215: the last value) leaves of the untouched ``a``.
That is the least noise there can be: a reference model misses 3 to 80 mrad on the XL330. There is
no oracle.

**T3, really made.** ``intervention`` says which:

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

import argparse
import hashlib
import json
import secrets
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rng = np.random.Generator
Parameters = dict[str, Any]
Window = tuple[float, float]

COUNTS = {"null": 46, "single": 50, "double": 10, "outside": 24}
TRAP_SHARE = 0.2  # of the nulls
DISORDERED = 0.1  # of the others
XL330 = ("sin_sin", "sin_time_square", "up_and_down")
DROP = "lift_and_drop"
GRAVITY_M_S2 = 9.80665
COUNT_RAD = 2 * np.pi / 4096
THIN = 4
EMPS_TURNS = (0, 6224, 12464, 18704, 24841)
SOURCES = {
    "xl330": "Rhoban, BAM: Better Actuator Models (github.com/Rhoban/bam), Apache-2.0; adapted.",
    "sts": "B. Kotov, Robonine (doi 10.5281/zenodo.17903002), CC BY 4.0; adapted.",
    "emps": "A. Janot, M. Gautier, M. Brunot: Data Set and Reference Models of EMPS; adapted.",
}
SERVOS = {  # max_torque_Nm, no_load_speed_rad_s, position_step_rad
    "xl330": (0.71, 15.9, 0.00153398),
    "sts": (2.94, 4.71, 0.00153398),
    "emps": (400.0, 10.0, 5e-8),
}


@dataclass(frozen=True)
class Log:
    """A real recording: times (T,), set-points and angles (T, J) and stated loads."""

    name: str
    family: str
    t: Array
    command: Array
    position: Array
    load: dict[str, float]
    supply_V: Array
    duty: Array

    @property
    def joints(self) -> list[str]:
        """Names of the joints."""
        return [f"j{k + 1}" for k in range(self.position.shape[1])]

    @property
    def step(self) -> float:
        """Of the sensor, rad."""
        return 5e-8 if self.family == "emps" else COUNT_RAD

    def rows(self, keep: NDArray[Any]) -> Log:
        """Some samples of it."""
        names = ("t", "command", "position", "supply_V", "duty")
        return replace(self, **{name: getattr(self, name)[keep] for name in names})

    def reads(self, j: int, angle: Array) -> Log:
        """With other angles of a joint."""
        position = self.position.copy()
        position[:, j] = angle
        return replace(self, position=position)

    def fine(self) -> Log:
        """With angles between the steps of the sensor that round to the recorded ones."""
        if self.family == "emps":
            return self
        kernel, half = np.ones(9) / 9, 0.49 * self.step
        padded = np.pad(self.position, ((4, 4), (0, 0)), mode="edge")
        smooth = np.stack([np.convolve(x, kernel, "valid") for x in padded.T], axis=1)
        angles = np.clip(smooth, self.position - half, self.position + half)
        return replace(self, position=angles)

    def rounded(self) -> Log:
        """With angles rounded to the steps of the sensor."""
        return replace(self, position=np.round(self.position / self.step) * self.step)

    def sends(self, j: int, command: Array) -> Log:
        """With other set-points of a joint."""
        changed = self.command.copy()
        changed[:, j] = command
        return replace(self, command=changed)


def backgrounds(folder: Path) -> dict[str, list[Log]]:
    """Logs of one rig in one condition, by group; those of the XL330 end with lift_and_drop."""
    groups = {}
    for gain in (200, 800):
        paths = [folder / "bam_xl330" / f"xl330_kp{gain}_{n}.csv" for n in (*XL330, DROP)]
        groups[f"xl330_{gain}"] = [_read(path, "xl330") for path in paths]
    for name in ("single", "nocomp2", "pgain_zero_db"):
        whole = _read(folder / "sts3215_backlash" / f"{name}.csv", "sts")
        groups[name] = list(_stretches(whole))
    data = pd.read_csv(folder / "emps" / "emps.csv")
    groups["emps"] = []
    for k, (start, stop) in enumerate(zip(EMPS_TURNS[:-1], EMPS_TURNS[1:], strict=True)):
        part = data.iloc[start:stop:THIN]
        t, command, angle = (part[c].to_numpy(float) for c in ("t_s", "reference_m", "position_m"))
        empty = np.full(t.size, np.nan)
        angles = command[:, None], angle[:, None]
        log = Log(f"emps_{k + 1}", "emps", np.round(t - t[0], 6), *angles, {}, empty, empty)
        groups["emps"].append(log)
    return groups


def _read(path: Path, family: str) -> Log:
    table = pd.read_csv(path)
    about = json.loads(path.with_suffix(".json").read_text())
    command, position = (
        np.stack([table[f"{j}.{q}"].to_numpy(float) for j in about["joints"]], axis=1)
        for q in ("command_rad", "position_rad")
    )
    t, duty = table["t_s"].to_numpy(float), table["j1.load"].to_numpy(float)
    supply = table["supply_V"].to_numpy(float) if "supply_V" in table else np.full(t.size, np.nan)
    load = about["loads"].get("j1", {})
    return Log(path.stem, family, t, command, position, load, supply, duty)


def _stretches(log: Log) -> Iterator[Log]:
    """Cut three samples before the tested servo steps away from 0."""
    away = np.abs(log.command[:, 0]) > 0.1
    cuts = [0, *(np.flatnonzero(away[1:] & ~away[:-1]) - 2), log.t.size]
    for k, (start, stop) in enumerate(zip(cuts[:-1], cuts[1:], strict=True)):
        if stop - start > 40:
            part = log.rows(np.arange(start, stop))
            yield replace(part, name=f"{log.name}_{k + 1}", t=np.round(part.t - part.t[0], 6))


class Unseen(Exception):
    """No window of a log shows what was drawn."""


def noise_rad(log: Log, j: int) -> float:
    """What an autoregression of the angle leaves, rad, by its median, as steps are no noise.

    Not less than rounding.
    """
    angle, order = log.position[:, j], 12
    if log.family == "sts":  # few samples, between steps
        left = np.diff(angle)
    else:
        past = np.lib.stride_tricks.sliding_window_view(angle, order)[:-1]
        past = np.column_stack([past, np.ones(len(past))])
        left = angle[order:] - past @ np.linalg.lstsq(past, angle[order:], rcond=None)[0]
    return float(max(1.4826 * np.median(np.abs(left)), log.step / np.sqrt(12)))


def rms(x: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(x**2)))


def _rate(x: Array, t: Array) -> Array:
    return np.asarray(np.gradient(x, t))


# Effects of the catalogue: parameters for a change of about ``size`` rad of a log, and the change.


def _signed(size: float, rng: Rng) -> float:
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
    sent = command + p["time_constant_s"] * _rate(command, log.t)
    sent[0] = command[0]
    return log.sends(j, sent)


def _jitter(log: Log, j: int, p: Parameters, rng: Rng) -> Log:
    late = rng.uniform(-p["halfwidth_s"], p["halfwidth_s"], size=log.t.size)
    late[0] = 0.0
    return log.sends(j, np.interp(log.t + late, log.t, log.command[:, j]))


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


ALL, SMOOTH = ("xl330", "sts", "emps"), ("xl330", "emps")
SIZE_RAD = {"xl330": 1e-3, "sts": 1.5e-3, "emps": 2e-5}
EFFECTS = {  # in the order in which two of them are put in
    "command_filter": Change(
        "command", SMOOTH,
        lambda g, j, size, rng: {
            "time_constant_s": min(size / rms(_rate(g.command[:, j], g.t)), 0.08)
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
        lambda g, j, size, rng: {"gain": 1 + _signed(size / rms(g.position[:, j]), rng)},
        _gain,
    ),
    "sensor_offset": Change(
        "none", ALL, lambda g, j, size, rng: {"offset_rad": _signed(size, rng)}, _offset
    ),
    "sensor_filter": Change(
        "speed", SMOOTH,
        lambda g, j, size, rng: {
            "time_constant_s": min(size / rms(_rate(g.position[:, j], g.t)), 0.08)
        },
        _filter,
    ),
    "clock_drift": Change(
        "time", SMOOTH,
        lambda g, j, size, rng: {
            "s_per_s": min(size / rms(g.t * _rate(g.position[:, j], g.t)), 0.02)
        },
        _drift, "link",
    ),
    "encoder_quantization": Change(
        "none", ("xl330", "sts"),
        lambda g, j, size, rng: {"step_rad": g.step * int(rng.integers(2, 9))},
        _quantize,
    ),
}  # fmt: skip


# Physics outside the catalogue. Parameters hold the window where there is one.


def _inside(log: Log, p: Parameters) -> NDArray[np.bool_]:
    start, stop = p["window_s"]
    return np.asarray((log.t >= start) & (log.t <= stop))


def _slip(log: Log, j: int, p: Parameters, _: Rng) -> Log:
    return log.reads(j, log.position[:, j] + p["slip_rad"] * _inside(log, p))


def _stick(log: Log, j: int, p: Parameters, _: Rng) -> Log:
    inside, angle = _inside(log, p), log.position[:, j].copy()
    angle[inside] = angle[int(np.argmax(inside)) - 1]
    return log.reads(j, angle)


def _bend(log: Log, j: int, p: Parameters, _: Rng) -> Log:
    angle = log.position[:, j]
    bump = np.sin(2 * np.pi * angle / p.get("bump_period_rad", 1.0) + p.get("bump_phase_rad", 0.0))
    return log.reads(
        j, angle + p.get("bend_per_rad", 0.0) * angle**2 + p.get("bump_rad", 0.0) * bump
    )


def _spike(log: Log, j: int, p: Parameters, rng: Rng) -> Log:
    """One sample in five, and the first and last of the window."""
    inside = np.flatnonzero(_inside(log, p))
    hit = inside[rng.random(inside.size) < 0.2]
    hit = np.unique([inside[0], *hit, inside[-1]])
    angle = log.position[:, j].copy()
    angle[hit] += p["spike_rad"] * rng.uniform(1, 3, hit.size) * rng.choice([-1.0, 1.0], hit.size)
    return log.reads(j, angle)


def _drop_out(log: Log, j: int, p: Parameters, rng: Rng) -> Log:
    """Holds of up to ``longest`` samples, each followed by one good sample."""
    inside, angle = np.flatnonzero(_inside(log, p)), log.position[:, j].copy()
    k = int(inside[0])
    while k <= inside[-1]:
        stop = min(k + int(rng.integers(1, p["longest"] + 1)), int(inside[-1]) + 1)
        angle[k:stop] = angle[k - 1]
        k = stop + 1
    return log.reads(j, angle)


def _late(log: Log, j: int, p: Parameters, _: Rng) -> Log:
    angle = log.position[:, j]
    old = np.interp(log.t - p["late_s"], log.t, angle)
    return log.reads(j, np.where(_inside(log, p), old, angle))


def _draw_bend(log: Log, j: int, size: float, rng: Rng) -> Parameters:
    angle = log.position[:, j]
    if rng.random() < 0.4:
        return {"bend_per_rad": _signed(size / rms(angle**2), rng)}
    return {
        "bump_rad": size,
        "bump_period_rad": float(np.ptp(angle) * rng.uniform(0.4, 0.7)),
        "bump_phase_rad": float(rng.uniform(0, 2 * np.pi)),
    }


OUTSIDERS = {
    "horn_slip": Change(
        "time", ALL, lambda g, j, size, rng: {"slip_rad": _signed(size, rng)}, _slip,
        lasts_s=(np.inf, np.inf),
    ),
    "stuck_sensor": Change(
        "time", ALL, lambda g, j, size, rng: {}, _stick, lasts_s=(0.4, 1.2)
    ),
    "potentiometer": Change("position", ALL, _draw_bend, _bend),
    "sensor_spikes": Change(
        "time", ALL, lambda g, j, size, rng: {"spike_rad": size}, _spike, lasts_s=(0.6, 1.5)
    ),
    "sensor_dropout": Change(
        "time", SMOOTH, lambda g, j, size, rng: {"longest": int(rng.integers(8, 25))}, _drop_out,
        lasts_s=(0.8, 2.0),
    ),
    "timestamp_glitch": Change(
        "time", SMOOTH,
        lambda g, j, size, rng: {
            "late_s": float(np.clip(2 * size / rms(_rate(g.position[:, j], g.t)), 0.02, 0.25))
        },
        _late,
        lasts_s=(0.4, 1.5),
    ),
}  # fmt: skip


def draw_window(change: Change, log: Log, rng: Rng) -> Window:
    """A window away from the ends that begins and ends at samples, or lasts to the end."""
    assert change.lasts_s is not None
    first, last = log.t[0], log.t[-1]
    if np.isinf(change.lasts_s[1]):
        start, stop = first + (last - first) * rng.uniform(0.3, 0.75), last
    else:
        length = rng.uniform(*change.lasts_s)
        start = rng.uniform(first + 0.5, last - 0.3 - length)
        stop = start + length
    inside = np.flatnonzero((log.t >= start) & (log.t <= stop))
    return float(log.t[inside[0]]), float(log.t[inside[-1]])


def gaps(log: Log, rng: Rng) -> Log:
    """With rows missing, single ones and some in a row; the first few and the last stay."""
    out = set(rng.integers(5, log.t.size - 1, size=int(rng.integers(3, 12))).tolist())
    for _ in range(int(rng.integers(1, 4)) if log.t.size > 500 else 0):
        start = int(rng.integers(20, log.t.size - 60))
        out |= set(range(start, start + int(rng.integers(5, 50))))
    return log.rows(np.array([k for k in range(log.t.size) if k not in out]))


# T2


def injected(groups: dict[str, list[Log]], counts: dict[str, int], rng: Rng) -> list[Any]:
    """Cases of T2 in random order: recordings by name, and the answer."""
    plan: list[tuple[str, tuple[str, ...]]] = [("null", ())] * counts["null"]
    names, others = rng.permutation(list(EFFECTS)), rng.permutation(list(OUTSIDERS))
    plan += [("single", (str(names[k % names.size]),)) for k in range(counts["single"])]
    for _ in range(counts["double"]):
        pair = {str(n) for n in rng.choice(names[names != "latency_jitter"], 2, replace=False)}
        plan.append(("double", tuple(n for n in EFFECTS if n in pair)))
    plan += [("outside", (str(others[k % others.size]),)) for k in range(counts["outside"])]
    traps = int(np.ceil(TRAP_SHARE * counts["null"]))
    seen: set[Any] = set()
    cases: list[Any] = []
    for k, (kind, hidden) in enumerate(plan):
        trap = "clock" if k < traps else ""
        disorder = bool(trap) or (kind != "null" and rng.random() < DISORDERED)
        while len(cases) == k:
            with suppress(Unseen):
                name = "trap" if trap else kind
                cases.append(_case(groups, name, hidden, disorder, seen, rng))
    return [cases[i] for i in rng.permutation(len(cases))]


def _case(
    groups: dict[str, list[Log]],
    kind: str,
    hidden: tuple[str, ...],
    disorder: bool,
    seen: set[Any],
    rng: Rng,
) -> Any:
    changes = {name: (EFFECTS | OUTSIDERS)[name] for name in hidden}
    while True:
        takes, heldout = _takes(groups, rng)
        log = takes["a"]
        key = tuple(take.name for name, take in takes.items() if name != "c")
        if any(log.family not in change.families for change in changes.values()):
            continue
        jerky = not all(_starts_gently(takes[name]) for name in ("a", "c"))
        if "command_filter" in changes and jerky:
            continue
        if kind != "null" or key not in seen:  # no null twice
            break
    if kind == "null":
        seen.add(key)
    untouched = {name: take.name for name, take in takes.items()}
    j = int(rng.integers(len(log.joints)))
    noise = noise_rad(log, j)
    if changes:
        fine = {name: take.fine() for name, take in takes.items() if name[:3] != "ref"}
        takes |= fine
    effects: list[Any] = []
    windows: dict[str, list[Window]] = {}
    for name, change in changes.items():
        low, high = (10, 100) if kind == "outside" else (0.3, 60)
        size = SIZE_RAD[log.family] * low * (high / low) ** rng.uniform()
        p = change.draw(log, j, float(size), rng)
        least = 3 * noise if kind == "outside" else 0.0
        after = {}
        for each in takes:
            if not each.startswith("ref"):
                after[each], window = _put(change, takes[each], j, p, least, rng)
                if window:
                    windows[each] = [window]
        column = "command" if name in ("command_filter", "latency_jitter") else "position"
        moved = rms(getattr(after["a"], column)[:, j] - getattr(takes["a"], column)[:, j])
        takes |= after
        about = {"noise_rad": noise, "change_rms_rad": moved, "change_of": column}
        effects.append(
            {
                "effect": name,
                "component": change.component or log.joints[j],
                "parameters": p if kind != "outside" else {},
                "strength": moved / noise,
                "driver": change.driver,
                "detail": about | (p if kind == "outside" else {}),
            }
        )
    if changes:
        takes |= {name: takes[name].rounded() for name in fine}
    if disorder:
        takes["a"] = gaps(takes["a"], rng)
    answer = {
        "tier": "T2",
        "kind": kind,
        "trap": "clock" if kind == "trap" else "",
        "clock_disturbed": disorder,
        "model_given": "none",
        "effects": effects,
        "windows_s": windows,
        "driver": effects[0]["driver"] if effects else "none",
        "background": untouched,
        "heldout_background": heldout,
        "oracle": {},
    }
    return takes, answer


def _starts_gently(log: Log) -> bool:
    steps = np.abs(np.diff(log.command[:, 0]))
    return bool(steps[0] < 0.1 * np.nanmax(steps))


def _put(
    change: Change, log: Log, j: int, p: Parameters, least: float, rng: Rng
) -> tuple[Log, Window | None]:
    """A log with a change; where it has a window, one in which it shows."""
    if change.lasts_s is None:
        return change.put(log, j, p, rng), None
    for _ in range(1000):
        window = draw_window(change, log, rng)
        after = change.put(log, j, p | {"window_s": window}, rng)
        moved = after.position[:, j] - log.position[:, j]
        inside = (log.t >= window[0]) & (log.t <= window[1])
        if rms(moved[inside]) >= least:
            return after, window
    raise Unseen


def _takes(groups: dict[str, list[Log]], rng: Rng) -> tuple[dict[str, Log], str]:
    """References, a, sometimes b, and c from one group; and whether c is also a reference."""
    weights = {"xl330_200": 0.35, "xl330_800": 0.35, "emps": 0.12}
    shares = np.array([weights.get(name, 0.06) for name in groups])
    logs = groups[str(rng.choice(list(groups), p=shares / shares.sum()))]
    order = [logs[k] for k in rng.permutation(3 if logs[0].family == "xl330" else len(logs))]
    if logs[0].family == "xl330":
        a, c = order[:2]
        unseen = bool(rng.random() < 0.5)
        references, rest = [*([] if unseen else [c]), order[2], logs[3]], []
        heldout = "unseen" if unseen else "also a reference"
    else:
        a, c, *rest = order
        references, rest = rest[:2], rest[2:]
        heldout = "same command" if a.family == "emps" else "unseen"
    named = {f"ref_{k + 1}": log for k, log in enumerate(references)}
    return named | {"a": a} | dict(zip("b", rest, strict=False)) | {"c": c}, heldout


# T3


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
    return {
        "tier": "T3",
        "kind": kind,
        "trap": "",
        "clock_disturbed": False,
        "model_given": "none",
        "effects": list(effects),
        "windows_s": {},
        "driver": effects[0]["driver"] if effects else "none",
        "background": {name: take.name for name, take in takes.items()},
        "intervention": intervention,
        "note": note,
        "changed": changed,
        "exclusive": True,
        "oracle": {},
    }


# Files


def write(cases: list[Any], seed: int, out: Path) -> None:
    """Inputs, held-out recordings, answers and hashes of one set."""
    answers = []
    for k, (takes, answer) in enumerate(cases):
        name = f"case_{k + 1:04d}"
        inputs, held_out = out / "inputs" / name, out / "heldout" / name
        for folder in (inputs, held_out):
            folder.mkdir(parents=True)
        (inputs / "robot.toml").write_text(robot_toml(takes["a"]))
        for recording, log in takes.items():
            folder = held_out if recording == "c" else inputs
            (folder / f"{recording}.csv").write_text(table(log))
            (folder / f"{recording}.json").write_text(json.dumps(sidecar(log), indent=2) + "\n")
        answers.append({"case": name, **answer, "seed": seed})
    (out / "answers.json").write_text(json.dumps(answers, indent=1) + "\n")
    (out / "hashes.json").write_text(json.dumps(hashes(out), indent=1) + "\n")


def hashes(out: Path) -> dict[str, Any]:
    """SHA-256 of the answers, of all recordings together, of this file."""
    data = hashlib.sha256()
    for path in sorted([*(out / "inputs").rglob("*.*"), *(out / "heldout").rglob("*.*")]):
        data.update(f"{path.relative_to(out).as_posix()} {_sha256(path)}\n".encode())
    return {
        "answers.json": _sha256(out / "answers.json"),
        "recordings": data.hexdigest(),
        "generator": {Path(__file__).name: _sha256(Path(__file__))},
    }


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def table(log: Log) -> str:
    """A recording as CSV."""
    header, columns = ["t_s"], [log.t]
    for j, joint in enumerate(log.joints):
        header += [f"{joint}.command_rad", f"{joint}.position_rad"]
        columns += [log.command[:, j], log.position[:, j]]
    digits = 9 if log.family == "emps" else 6
    rows = np.stack(columns, axis=1).tolist()
    lines = [",".join("" if x != x else f"{x:z.{digits}f}" for x in row) for row in rows]
    return "\n".join([",".join(header), *lines]) + "\n"


def sidecar(log: Log) -> dict[str, Any]:
    """The JSON beside a recording."""
    return {
        "schema": "sim2real.recording/1",
        "kind": "servo",
        "joints": log.joints,
        "loads": {"j1": log.load} if log.load else {},
        "medium": "air",
        "source": SOURCES[log.family],
    }


def robot_toml(log: Log) -> str:
    """A robot whose links say nothing of the load."""
    torque, speed, step = SERVOS[log.family]
    parts = ['name = "bench"\n']
    for k in range(len(log.joints) + 1):
        size = "length_m = 0.10\nwidth_m = 0.05\nheight_m = 0.05"
        parts.append(f'[[links]]\nname = "link{k}"\nmass_kg = 0.2\n{size}\n')
    for joint in log.joints:
        limits = "limits_rad = [-3.14, 3.14]"
        parts.append(f'[[joints]]\nname = "{joint}"\nservo = "servo"\n{limits}\n')
    parts.append(
        f"[servos.servo]\nmax_torque_Nm = {torque}\nno_load_speed_rad_s = {speed}\n"
        f"position_step_rad = {step:.8f}\n"
    )
    return "\n".join(parts)


def main(arguments: Sequence[str] | None = None) -> None:
    """Write both sets."""
    parser = argparse.ArgumentParser(description="Make sealed sets out of real recordings.")
    parser.add_argument("out2", type=Path, metavar="OUT2", help="changes put in (T2)")
    parser.add_argument("out3", type=Path, metavar="OUT3", help="changes really made (T3)")
    parser.add_argument("--realdata", type=Path, required=True, metavar="DIR")
    parser.add_argument("--seed", type=int, help="default: drawn and kept in the answers")
    for kind, count in COUNTS.items():
        parser.add_argument(f"--{kind}", type=int, default=count, metavar="N", help="cases of T2")
    options = parser.parse_args(arguments)
    for out in (options.out2, options.out3):
        if out.exists() and any(out.iterdir()):
            parser.error(f"{out} is not empty")
    if not options.realdata.is_dir():
        parser.error(f"no folder {options.realdata}")
    seed = secrets.randbits(64) if options.seed is None else options.seed
    second, third = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2))
    groups = backgrounds(options.realdata)
    counts = {kind: getattr(options, kind) for kind in COUNTS}
    write(injected(groups, counts, second), seed, options.out2)
    write(concealed(groups, third), seed, options.out3)


if __name__ == "__main__":
    main()
