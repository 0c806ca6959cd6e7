"""Excitation signals for identification, within the limits of joints and servos."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import signal as waves

from sim2real.arrays import Array
from sim2real.errors import InputError
from sim2real.recording import read_commands
from sim2real.robot import Joint

REST_S = 0.5
"""Time in s for which the first set-point is held before the motion starts."""
SHORTEST_HOLD_S, LONGEST_HOLD_S = 0.4, 1.5  # of a level of ``steps``
DEFAULT_REACH = 0.75  # amplitude as a share of half the joint's range


@dataclass(frozen=True)
class Shape:
    """Frequency of ``sine`` and ``square``, lowest and highest of ``chirp`` and ``multisine``."""

    frequency_hz: float = 1.0
    band_hz: tuple[float, float] = (0.1, 2.0)


@dataclass(frozen=True)
class Excitation:
    """Set-points for several joints."""

    joints: tuple[str, ...]  # names of the J joints
    t: Array  # times in s, shape (T,), evenly spaced
    command: Array  # set-points in rad, shape (T, J)
    notes: tuple[str, ...] = ()  # how limits changed the requested signal, one sentence each

    @property
    def largest_rate(self) -> Array:
        """Largest speed of the set-point of each joint in rad/s, shape (J,)."""
        rate: Array = np.abs(np.diff(self.command, axis=0)).max(axis=0) / self.t[1]
        return rate


def steps(t: Array, shape: Shape, rng: np.random.Generator) -> Array:
    """Random levels held for random times, starting at 0."""
    count = int(t[-1] / SHORTEST_HOLD_S) + 1
    changes = np.cumsum(rng.uniform(SHORTEST_HOLD_S, LONGEST_HOLD_S, count))
    levels = np.concatenate([[0.0], rng.uniform(-1, 1, count)])
    return np.asarray(levels[np.searchsorted(changes - changes[0], t, side="right")])


def multisine(t: Array, shape: Shape, rng: np.random.Generator) -> Array:
    """Sines of equal amplitude with Schroeder's phases: IEEE Trans. Inf. Theory 16 (1970) 85."""
    low, high = shape.band_hz
    spacing = max(low, 1 / float(t[-1]), (high - low) / 64)
    frequency = np.arange(low, high + 0.5 * spacing, spacing)
    order = np.arange(frequency.size)
    phase = rng.uniform(0, 2 * np.pi) - np.pi * order * (order + 1) / frequency.size
    wave = np.sin(2 * np.pi * np.outer(t, frequency) + phase).sum(axis=1)
    return np.asarray(wave / np.abs(wave).max())


UNIT: Mapping[str, Callable[[Array, Shape, np.random.Generator], Array]] = {
    "steps": steps,
    "sine": lambda t, shape, _: np.sin(2 * np.pi * shape.frequency_hz * t),
    "square": lambda t, shape, _: np.asarray(waves.square(2 * np.pi * shape.frequency_hz * t)),
    "chirp": lambda t, shape, _: np.asarray(
        waves.chirp(t, shape.band_hz[0], float(t[-1]), shape.band_hz[1], phi=-90)
    ),
    "multisine": multisine,
}
"""Signals between -1 and 1 at the times ``t`` (T,), by name; a chirp rises through the band."""

SMOOTH = ("sine", "chirp", "multisine")
"""Signals whose amplitude is reduced if they are too fast; the others are rate-limited."""


def excitation(
    name: str,
    joints: Sequence[Joint],
    *,
    seconds: float,
    rate_hz: float,
    rng: np.random.Generator,
    amplitude_rad: float | None = None,
    shape: Shape | None = None,
) -> Excitation:
    """One of ``UNIT`` for each of J joints, centred in its limits, within those of angle and speed.

    ``seconds`` include the rest at the beginning; ``amplitude_rad`` is the largest deviation from
    the centre, by default three quarters of the range. Random signals are independent.
    """
    shape = shape or Shape()
    (low, high), nyquist = shape.band_hz, rate_hz / 2
    if not 2 * REST_S <= seconds <= 86_400:
        raise InputError("--seconds", "", f"{seconds:g} s", f"{2 * REST_S:g} s to a day")
    if name in ("sine", "square") and not 0 < shape.frequency_hz < nyquist:
        expected = f"more than 0 and less than {nyquist:g} Hz"
        raise InputError("--frequency", "", f"{shape.frequency_hz:g} Hz", expected)
    if name in ("chirp", "multisine") and not 0 < low < high < nyquist:
        expected = f"two frequencies between 0 and {nyquist:g} Hz, the lower first"
        raise InputError("--band", "", f"{low:g} and {high:g} Hz", expected)
    t = np.arange(round(seconds * rate_hz)) / rate_hz
    commands, notes = [], []
    for joint in joints:
        low, high = joint.limits_rad
        unit = UNIT[name](np.maximum(t - REST_S, 0.0), shape, rng)
        unit[t < REST_S] = unit[t >= REST_S][0] if name in SMOOTH else 0.0
        largest, limit = (high - low) / 2, "its limits"
        fastest = float(np.abs(np.diff(unit)).max()) * rate_hz
        if name in SMOOTH and largest * fastest > joint.servo.no_load_speed_rad_s:
            largest, limit = joint.servo.no_load_speed_rad_s / fastest, "its servo's speed"
        requested = DEFAULT_REACH * (high - low) / 2 if amplitude_rad is None else amplitude_rad
        amplitude = min(requested, largest)
        if amplitude_rad is not None and amplitude < requested:
            notes.append(f"{joint.name}: {requested:g} rad cut to {amplitude:.3g} rad by {limit}.")
        commands.append(limited((low + high) / 2 + amplitude * unit, joint, rate_hz))
    names = tuple(joint.name for joint in joints)
    return Excitation(names, t, np.stack(commands, axis=1), tuple(notes))


def played(path: str | os.PathLike[str], joints: Sequence[Joint], *, rate_hz: float) -> Excitation:
    """The commands of a CSV file, each held until the next, after a rest at the first."""
    recording = read_commands(path)
    since = recording.t - recording.t[0] + REST_S
    t = np.arange(int(since[-1] * rate_hz + 1e-6) + 1) / rate_hz
    held = np.maximum(np.searchsorted(since, t + 1e-9, side="right") - 1, 0)
    columns, notes = [], []
    for joint in joints:
        column = f"{joint.name}.command_rad"
        if joint.name not in recording.joints:
            raise InputError(path, "header", f"no column {column}", f"the column {column}")
        requested = recording.commands[joint.name][held]
        if np.isnan(requested).any():
            raise InputError(path, column, "empty cells", "a set-point in every row")
        command = limited(requested, joint, rate_hz)
        changed = int((np.abs(command - requested) > 1e-9).sum())
        if changed:
            notes.append(f"{joint.name}: {changed} set-points changed by its limits and speed.")
        columns.append(command)
    names = tuple(joint.name for joint in joints)
    return Excitation(names, t, np.stack(columns, axis=1), tuple(notes))


def limited(command: Array, joint: Joint, rate_hz: float) -> Array:
    """Set-points (T,) within the joint's limits, no faster than its servo's no-load speed."""
    inside = np.clip(command, *joint.limits_rad)
    largest = joint.servo.no_load_speed_rad_s / rate_hz
    if np.abs(np.diff(inside)).max(initial=0.0) <= largest * (1 + 1e-9):
        return inside
    slewed = inside.copy()
    for k in range(1, slewed.size):
        slewed[k] = slewed[k - 1] + np.clip(inside[k] - slewed[k - 1], -largest, largest)
    return slewed
