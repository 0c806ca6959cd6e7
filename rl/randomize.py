"""Randomization ranges applied to a model: models drawn per episode, noise per step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim.inference.swims import with_values
from sim2real.arrays import Array
from sim2real.body import values
from sim2real.density import normalised_density
from sim2real.effects import named
from sim2real.errors import InputError
from sim2real.model import FittedEffect, JointModel, Law, Model
from sim2real.posterior.posteriors import JointSample
from sim2real.ranges.entry import Ranges
from sim2real.robot import Robot


@dataclass(frozen=True)
class Noise:
    """Standard deviations of the measurement noise, drawn at every step.

    Attributes:
        position_m: x and y of the head.
        yaw_rad: Heading of the head.
        joint_rad: Measured joint angles, one value for all or one per joint.
    """

    position_m: float = 0.0
    yaw_rad: float = 0.0
    joint_rad: tuple[float, ...] = (0.0,)


def noise_of(ranges: Ranges, joints: Sequence[str]) -> Noise:
    """The measurement noise in the ranges."""

    def sd(name: str) -> float:
        entry = ranges.named(name)
        return 0.0 if entry is None or entry.period != "step" else entry.second

    per_joint = tuple(sd(f"{joint}.position_noise_rad") for joint in joints)
    return Noise(sd("body.position_noise_m"), sd("body.yaw_noise_rad"), per_joint)


def draw_models(
    model: Model,
    ranges: Ranges,
    robot: Robot,
    n: int,
    rng: np.random.Generator,
    sample: JointSample | None = None,
) -> list[Model]:
    """Models for n episodes: the calibrated model with values drawn from each range.

    Rows of a posterior ``sample`` replace independent draws of the parameters that it shares with
    the ranges.

    Raises:
        InputError: If the parameter of a range is neither of the model nor of the robot.
    """
    model = with_density(model, robot)
    links = [link.name for link in robot.links]
    entries = [entry for entry in ranges.entries if entry.period == "episode"]
    columns = {
        entry.parameter: (rng.uniform if entry.distribution == "uniform" else rng.normal)(
            entry.first, entry.second, n
        )
        for entry in entries
    }
    if sample is not None:
        rows = sample.values[rng.integers(len(sample.values), size=n)]
        columns |= {p: rows[:, k] for k, p in enumerate(sample.names) if p in columns}
    draws = ({name: float(x[i]) for name, x in columns.items()} for i in range(n))
    return [_with(model, links, draw) for draw in draws]


def with_density(model: Model, robot: Robot) -> Model:
    """The model, with the normalised densities of the robot if it has none."""
    if "normalised_density" in model.body:
        return model
    density = normalised_density(robot).value
    return replace(model, body={**model.body, "normalised_density": [float(x) for x in density]})


def _with(model: Model, links: Sequence[str], draw: Mapping[str, float]) -> Model:
    """The model with the values of one episode."""
    joints = dict(model.joints)
    scalars: dict[str, float] = {}
    density = dict(zip(links, model.body["normalised_density"], strict=True))
    for name, value in draw.items():
        head, _, tail = name.partition(".")
        if name.startswith("body.normalised_density."):
            link = name.rsplit(".", 1)[1]
            if link not in density:
                raise InputError("ranges", name, "no such link", f"one of {', '.join(links)}")
            density[link] = value
        elif head in joints and "." in tail:
            group, parameter = tail.split(".", 1)
            joints[head] = _with_servo(joints[head], group, parameter, value)
        elif head in joints and tail in ("kp_Nm_per_rad", "kd_Nms_per_rad"):
            scalars[name] = value
        elif head == "body":
            scalars[tail] = value
        elif head not in joints and name != "command_latency_s":
            for joint in joints:
                joints[joint] = _with_servo(joints[joint], head, tail, value)
    if "command_latency_s" in draw:
        for joint in joints:
            delay = draw["command_latency_s"] + draw.get(f"{joint}.latency_offset_s", 0.0)
            joints[joint] = replace(joints[joint], latency_s=max(0.0, delay))
    body = {**model.body, "normalised_density": list(density.values())}
    return with_values(replace(model, joints=joints, body=body), scalars)


def _with_servo(joint: JointModel, group: str, parameter: str, value: float) -> JointModel:
    """The joint with another value of an effect's parameter, or of the motor's."""
    if group == "motor":
        law: Law = "motor" if joint.law == "pd" else joint.law
        return replace(joint, law=law, motor={**joint.motor, parameter: value})
    named(group, "ranges")
    parameters = {one.effect: dict(one.parameters) for one in joint.effects}
    parameters.setdefault(group, {})[parameter] = value
    return replace(joint, effects=tuple(FittedEffect(*item) for item in parameters.items()))


def parameters_of(models: Sequence[Model]) -> tuple[list[str], Array]:
    """Names and values (N, P) of all numbers of models; 0 where a model lacks an effect."""
    rows = [numbers_of(model) for model in models]
    names = list(dict.fromkeys(name for row in rows for name in row))
    return names, np.array([[row.get(name, 0.0) for name in names] for row in rows])


def spread_of(models: Sequence[Model]) -> dict[str, list[float]]:
    """5 % and 95 % quantile of each number of models, by name."""
    names, table = parameters_of(models)
    return dict(zip(names, np.quantile(table, (0.05, 0.95), axis=0).T.tolist(), strict=True))


def numbers_of(model: Model) -> dict[str, float]:
    """All numbers of a model that realities and ranges vary, by name."""
    out: dict[str, float] = {}
    for name, joint in model.joints.items():
        gains = ("kp_Nm_per_rad", "kd_Nms_per_rad", "latency_s")
        out |= {f"{name}.{gain}": getattr(joint, gain) for gain in gains}
        out |= {f"{name}.motor.{key}": value for key, value in joint.motor.items()}
        for effect in joint.effects:
            out |= {f"{name}.{effect.effect}.{k}": v for k, v in effect.parameters.items()}
    for link, value in enumerate(model.body.get("normalised_density", ())):
        out[f"body.normalised_density.{link}"] = float(value)
    out |= {f"twin.{key}": float(value) for key, value in model.body.get("twin", {}).items()}
    return out | {f"body.{key}": value for key, value in values(model).items()}
