"""Ranges from single sources: posterior, model, body, and noise of joints and camera."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from sim2real.body import body_effect, values
from sim2real.model import JointModel, Model
from sim2real.noise import difference_noise, noise_floor
from sim2real.posterior.servo import ServoPosterior
from sim2real.ranges.entry import Range, normal, uniform
from sim2real.recording import Recording
from sim2real.robot import Density
from sim2real.servo.parameters import GAINS
from sim2real.structured import finite_number
from sim2real.units import unit_of

_STRIBECK_SPEED = "motor.stribeck_speed_rad_s"
_FEWEST = 60
"""Smallest number of samples for an estimate of the noise."""


def labelled(recordings: Sequence[Recording]) -> dict[str, str]:
    """A label for each file: the recording's name, or its path where several have that name."""
    names = [recording.name for recording in recordings]
    return {r.file: r.name if names.count(r.name) == 1 else r.file for r in recordings}


def listed(labels: Iterable[str], most: int = 4) -> str:
    """Labels separated by commas; more than ``most`` are abbreviated."""
    names = list(labels)
    if len(names) > most:
        return f"{names[0]} to {names[-1]} ({len(names)} recordings)"
    return ", ".join(names)


def from_posterior(joint: str, posterior: ServoPosterior, recordings: str) -> list[Range]:
    """Ranges of all sampled parameters except the latency, which has a separate range."""
    low, _, high = posterior.quantiles(*posterior.shares)
    shares = " and ".join(f"{100 * share:g} %" for share in posterior.shares[::2])
    source = f"{recordings}: {shares} quantiles of the posterior"
    return [
        uniform(f"{joint}.{prior.name}", low[k], high[k], prior.unit, source)
        for k, prior in enumerate(posterior.parameters)
        if prior.name != "latency_s"
    ]


def from_model(
    joint: str, model: JointModel, level: float, existing: Sequence[str] = ()
) -> tuple[list[Range], list[str]]:
    """Ranges by the model's intervals of this level, or values, except ``existing``; and notes."""
    values = parameters_of(model)
    out, its = [], f"the model: its {100 * level:g} % interval"
    for name, value in values.items():
        if f"{joint}.{name}" in existing or _is_absent(name, model):
            continue
        low, high = model.interval.get(name, (value, value))
        source = its if name in model.interval else "the model: its value; it gives no interval"
        if not (math.isfinite(low) and math.isfinite(high)):
            source = f"{its}, an open end taken at the value"
            low, high = (end if math.isfinite(end) else value for end in (low, high))
        unit = unit_of(name, per_inertia=model.per_inertia)
        out.append(uniform(f"{joint}.{name}", low, high, unit, source))
    absent = ", ".join(
        f"{name} (to {model.interval[name][1]:.2g})"
        for name in sorted({*values, *model.interval} - {_STRIBECK_SPEED})
        if _is_absent(name, model)
    )
    note = f"{joint}: no range, as the {100 * level:g} % interval begins at 0: {absent}"
    return out, [note] if absent else []


def parameters_of(model: JointModel) -> dict[str, float]:
    """Gains of a joint and parameters of its motor and effects, as they are named in ranges."""
    values = {name: getattr(model, name) for name in GAINS}
    values |= {f"motor.{name}": value for name, value in model.motor.items()}
    for effect in model.effects:
        values |= {f"{effect.effect}.{name}": x for name, x in effect.parameters.items()}
    return values


def _is_absent(name: str, model: JointModel) -> bool:
    """Whether a loss of the motor is next to 0, where its interval begins."""
    if name == _STRIBECK_SPEED:  # it has a meaning only with one of the losses
        return all(
            model.motor.get(key, 0.0) == 0 or _is_absent(f"motor.{key}", model)
            for key in ("stribeck_motor_friction", "stribeck_load_friction")
        )
    low, high = model.interval.get(name, (math.nan, math.nan))
    value = model.motor.get(name.removeprefix("motor."), 0.0)
    return name.startswith("motor.") and low <= 0 and value <= 0.01 * high


def density_ranges(density: Density) -> list[Range]:
    """Normalised density of each link with stated standard deviations of mass or length."""
    if density.sd is None:
        return []
    source = "mass_sd_kg and length_sd_m of the robot's links, through the density's derivatives"
    return [
        normal(f"body.normalised_density.{name}", value, sd, "", source)
        for name, value, sd in zip(density.links, density.value, density.sd, strict=True)
        if sd > 0
    ]


def body_ranges(model: Model) -> list[Range]:
    """Calibrated parameters of the model's body, from its 90 % intervals."""
    intervals: Mapping[str, Any] = model.body.get("interval") or {}
    out = []
    for name, value in values(model).items():
        low, high, source = value, value, "the model's body: its value; it gives no interval"
        if name in intervals:
            ends = [finite_number(end) for end in intervals[name]]
            low, high = (value if end is None else end for end in ends)
            source = "the model's body: its 90 % interval"
        effect, *_, parameter = name.split(".")
        unit = next(p.unit for p in body_effect(effect).parameters if p.name == parameter)
        out.append(uniform(f"body.{name}", low, high, unit, source))
    return out


def shared_ranges(model: Model) -> list[Range]:
    """Effects of the supply and the link, which all joints share, with the model's values."""
    source = "the model: its value; it gives no interval"
    return [
        uniform(f"{effect.effect}.{name}", value, value, unit_of(name), source)
        for effect in model.effects
        for name, value in effect.parameters.items()
    ]


def joint_noise(recordings: Sequence[Recording], joint: str) -> Range | None:
    """Noise of the measured angle of one joint, with quantization; None without an estimate."""
    noise, labels = {}, labelled(recordings)
    for recording in (r for r in recordings if joint in r.joints):
        j = recording.joints.index(joint)
        position = recording.position[:, j]
        if np.isfinite(position).sum() >= _FEWEST:
            floor = noise_floor(recording.t, recording.command[:, j], position)
            noise[labels[recording.file]] = [floor]
    return _step(f"{joint}.position_noise_rad", "rad", noise, "noise floor") if noise else None


def camera_noise(recordings: Sequence[Recording]) -> list[Range]:
    """Independent noise of position and heading, from differences of high order of new frames."""
    place: dict[str, list[float]] = {}
    heading: dict[str, list[float]] = {}
    labels = labelled(recordings)
    for recording in (r for r in recordings if r.has_poses):
        label, none = labels[recording.file], np.full(recording.t.size, np.nan)
        poses = (recording.columns.get(f"body.{n}", none) for n in ("x_m", "y_m", "yaw_rad"))
        frames = np.stack([recording.t, *poses])
        # those in which the robot was tracked, without repeated ones
        frames = frames[:, np.isfinite(frames[1:3]).all(axis=0)]
        changed = (np.diff(frames[1:3]) != 0).any(axis=0)
        t, x, y, yaw = frames[:, np.concatenate([[True], changed])[: frames.shape[1]]]
        if t.size >= _FEWEST:
            place[label] = [difference_noise(t, x), difference_noise(t, y)]
        present = np.isfinite(yaw)
        if present.sum() >= _FEWEST:
            heading[label] = [difference_noise(t[present], np.unwrap(yaw[present]))]
    both = (("body.position_noise_m", "m", place), ("body.yaw_noise_rad", "rad", heading))
    how = "difference-based noise"
    return [_step(name, unit, noise, how) for name, unit, noise in both if noise]


def _step(name: str, unit: str, noise: Mapping[str, Sequence[float]], how: str) -> Range:
    """The root mean square of the noise in recordings, by their labels."""
    values = [value for several in noise.values() for value in several]
    source = f"{listed(noise)}: {how} of each, root mean square"
    return normal(name, 0.0, float(np.sqrt(np.mean(np.square(values)))), unit, source, "step")
