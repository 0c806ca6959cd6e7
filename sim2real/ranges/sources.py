"""What each range is read from: a servo, a body, the noise of joints and camera."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from sim2real.body import body_effect, values
from sim2real.density import Density
from sim2real.model import JointModel, Model
from sim2real.noise import difference_noise, noise_floor
from sim2real.posterior.servo import ServoPosterior
from sim2real.ranges.entry import Range, normal, uniform
from sim2real.ranges.episodes import labelled, listed
from sim2real.recording import Recording
from sim2real.structured import finite_number
from sim2real.units import unit_of

LOW, HIGH = 0.05, 0.95
"""Quantiles between which a parameter is randomized."""
_GAINS = ("kp_Nm_per_rad", "kd_Nms_per_rad")


def from_posterior(joint: str, found: ServoPosterior, recordings: str) -> list[Range]:
    """Everything sampled but the latency, which has a range of its own.

    Args:
        joint: The joint's name.
        found: Its posterior.
        recordings: Names of the recordings, for the source.
    """
    low, high = found.quantiles(LOW, HIGH)
    source = f"{recordings}: 5 % and 95 % quantiles of the posterior"
    return [
        uniform(f"{joint}.{prior.name}", low[k], high[k], prior.unit, source)
        for k, prior in enumerate(found.priors.each)
        if prior.name != "latency_s"
    ]


def from_model(joint: str, model: JointModel, known: Sequence[str] = ()) -> list[Range]:
    """What the model says by itself: its 90 % intervals, or its values where it has none.

    Args:
        joint: The joint's name.
        model: The joint.
        known: Parameters that have a range already.
    """
    values = {name: getattr(model, name) for name in _GAINS}
    for effect in model.effects:
        values |= {f"{effect.effect}.{name}": x for name, x in effect.parameters.items()}
    out = []
    for name, value in values.items():
        if f"{joint}.{name}" in known:
            continue
        low, high = model.interval.get(name, (value, value))
        source = "the model: its 90 % interval"
        if name not in model.interval:
            source = "the model: its value; it gives no interval"
        elif not (math.isfinite(low) and math.isfinite(high)):
            source = "the model: its 90 % interval, an open end taken at the value"
            low, high = (end if math.isfinite(end) else value for end in (low, high))
        unit = unit_of(name, per_inertia=model.per_inertia)
        out.append(uniform(f"{joint}.{name}", low, high, unit, source))
    return out


def density_ranges(density: Density) -> list[Range]:
    """Normalised density of each link, where scale and ruler say how sure they are."""
    if density.sd is None:
        return []
    source = "mass_sd_kg and length_sd_m of the robot's links, through the density's derivatives"
    return [
        normal(f"body.normalised_density.{name}", value, sd, "", source)
        for name, value, sd in zip(density.links, density.value, density.sd, strict=True)
        if sd > 0
    ]


def body_ranges(model: Model) -> list[Range]:
    """Drag and whatever else the model's body was calibrated to, from its 90 % intervals."""
    intervals = model.body.get("interval")
    given: Mapping[str, object] = intervals if isinstance(intervals, Mapping) else {}
    out = []
    for name, value in values(model).items():
        low, high, source = value, value, "the model's body: its value; it gives no interval"
        ends = given.get(name)
        numbers = [finite_number(end) for end in ends] if isinstance(ends, list | tuple) else []
        if len(numbers) == 2:
            low, high = (value if end is None else end for end in numbers)
            source = "the model's body: its 90 % interval"
        out.append(uniform(f"body.{name}", low, high, _body_unit(name), source))
    return out


def shared_ranges(model: Model) -> list[Range]:
    """Effects on the supply and the link that all joints share, as the model has them."""
    source = "the model: its value; it gives no interval"
    return [
        uniform(f"{effect.effect}.{name}", value, value, unit_of(name), source)
        for effect in model.effects
        for name, value in effect.parameters.items()
    ]


def _body_unit(name: str) -> str:
    effect, *_, parameter = name.split(".")
    return next(p.unit for p in body_effect(effect).parameters if p.name == parameter)


Array = NDArray[np.float64]

_FEWEST = 60
"""Samples below which a recording says nothing of noise."""
_METHOD = "difference-based noise of each, root mean square"


def joint_noise(recordings: Sequence[Recording], joint: str) -> Range | None:
    """Noise of the measured angle of one joint, quantization included; None where none is seen."""
    found, labels = {}, labelled(recordings)
    for recording in (r for r in recordings if joint in r.joints):
        j = recording.joints.index(joint)
        position = recording.position[:, j]
        if np.isfinite(position).sum() >= _FEWEST:
            found[labels[recording.file]] = noise_floor(
                recording.t, recording.command[:, j], position
            )
    if not found:
        return None
    source = f"{listed(found)}: noise floor of each, root mean square"
    return _step(f"{joint}.position_noise_rad", "rad", list(found.values()), source)


def camera_noise(recordings: Sequence[Recording]) -> list[Range]:
    """Noise of position (x and y alike) and direction as the camera gives them.

    From differences of high order, which motion hardly touches: what it finds is noise that is
    independent from frame to frame. A frame that is repeated counts once.
    """
    place: dict[str, list[float]] = {}
    heading: dict[str, list[float]] = {}
    labels = labelled(recordings)
    for recording in (r for r in recordings if r.has_poses):
        label = labels[recording.file]
        t, x, y, yaw = _frames(recording)
        if t.size >= _FEWEST:
            place[label] = [difference_noise(t, x), difference_noise(t, y)]
        seen = np.isfinite(yaw)
        if seen.sum() >= _FEWEST:
            heading[label] = [difference_noise(t[seen], np.unwrap(yaw[seen]))]
    out = []
    for name, unit, found in (
        ("body.position_noise_m", "m", place),
        ("body.yaw_noise_rad", "rad", heading),
    ):
        if found:
            values = [value for pair in found.values() for value in pair]
            out.append(_step(name, unit, values, f"{listed(found)}: {_METHOD}"))
    return out


def _frames(recording: Recording) -> tuple[Array, Array, Array, Array]:
    """Times, x, y and yaw of the frames in which the robot was seen, repeated ones once."""
    none = np.full(recording.t.size, np.nan)
    x, y, yaw = (recording.columns.get(f"body.{n}", none) for n in ("x_m", "y_m", "yaw_rad"))
    seen = np.isfinite(x) & np.isfinite(y)
    t, x, y, yaw = (values[seen] for values in (recording.t, x, y, yaw))
    new = np.ones(t.size, dtype=bool)
    new[1:] = (np.diff(x) != 0) | (np.diff(y) != 0)
    return t[new], x[new], y[new], yaw[new]


def _step(name: str, unit: str, values: Sequence[float], source: str) -> Range:
    return normal(name, 0.0, float(np.sqrt(np.mean(np.square(values)))), unit, source, "step")
