"""A world from a robot, a simulator and episodes that are drawn from randomization ranges.

By default it has the three-joint fish of Lin, Liu and Wang (IEEE RA-L 2025) in the twin, with its
body calibrated to the first shipped swim (``datasets/pool``).
"""

import hashlib
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import torch

from rl.task import TASKS, Task
from rl.world import Draws, Noise, World
from sim.inference.swims import with_values
from sim.robot.live import Simulator, use_stream
from sim2real.arrays import Array
from sim2real.body import values
from sim2real.effects import named
from sim2real.errors import InputError, check_choice
from sim2real.model import FittedEffect, JointModel, Law, Model, read_model
from sim2real.posterior.posteriors import JointSample
from sim2real.ranges.entry import Ranges, read_ranges
from sim2real.robot import Robot, normalised_density, read_robot
from sim2real.structured import finite_number

Fidelity = Literal["twin", "fluid"]
File = str | os.PathLike[str]

FISH = Path(__file__).parent / "fish"
"""The robot, its calibrated model and its ranges that ship with the package."""
DRAWS = 512
"""Number of robots that episodes are drawn from; each occurs a few times in a training."""


def digest(content: object) -> str:
    """SHA-256 of what ``repr`` shows of a content."""
    return hashlib.sha256(repr(content).encode()).hexdigest()


def own_stream(device: str) -> AbstractContextManager[Any]:
    """Context manager with the stream that a world on CUDA needs; no effect on a CPU."""
    if device == "cpu" or not torch.cuda.is_available():
        return nullcontext()
    return torch.cuda.stream(torch.cuda.Stream(device))  # type: ignore[no-untyped-call]


def draws_of(model: Model, ranges: Ranges | None, robot: Robot, seed: int, n: int = DRAWS) -> Draws:
    """Episodes of a calibrated model, randomized if ranges are given."""
    if ranges is None:
        return Draws((model,))
    rng = np.random.default_rng(seed)
    models = draw_models(model, ranges, robot, n, rng)
    return Draws(models, noise_of(ranges, [joint.name for joint in robot.joints]))


def episodes_of(robot: str, model: str, ranges: str | None) -> tuple[Robot, Draws, list[str]]:
    """The robot and the episodes of a training, and the files that they are of."""
    fish, drawn = read_robot(robot), None if ranges is None else read_ranges(ranges)
    draws = draws_of(read_model(model), drawn, fish, seed=0)
    return fish, draws, [robot, model, *([] if ranges is None else [ranges])]


def world_of(
    n_envs: int,
    *,
    robot: Robot | File = FISH / "robot.toml",
    model: Model | File = FISH / "model.json",
    ranges: Ranges | File | None = None,
    task: str | Task = "point",
    energy_weight: float | None = None,
    reward: Mapping[str, float] | None = None,
    fidelity: Fidelity = "twin",
    device: str = "cpu",
    cell_m: float = 0.02,
    seed: int = 0,
) -> World:
    """A batch of robots with their task, for ``FishEnv``, ``FishVectorEnv`` and ``FishVecEnv``.

    Args:
        n_envs: Number of robots.
        robot: The robot, or its ``robot.toml``.
        model: Model of its servos and body, or ``MODEL.json``.
        ranges: Randomization ranges, or ``ranges.json``; without them every episode has the same
            robot and no noise.
        task: ``point``, ``near``, ``mixed``, ``chain``, ``turn``, ``zones`` or
            ``pentagram``, or a ``rl.task.Task``.
        energy_weight: Weight of the squared joint rates in the reward; by default the task's.
        reward: Weights of some of the reward's terms, ``approach``, ``energy`` and ``bonus``; by
            default the task's, 10, 0.001 and 10 in the paper.
        fidelity: ``twin`` or ``fluid``.
        device: ``cpu`` or ``cuda:0``.
        cell_m: Side of a cell of the fluid, in m.
        seed: Seed of random numbers until the first ``reset(seed=...)``.

    Raises:
        InputError: If a file does not conform to its format, there is no such task, fidelity or
            term, or a weight is no finite number of at least 0.
    """
    if not isinstance(task, Task):
        check_choice("sim2real/Fish-v0", "task", task, TASKS)
        task = TASKS[task]
    weights: dict[str, Any] = {
        **(reward or {}),
        **({} if energy_weight is None else {"energy": energy_weight}),
    }
    for name, weight in weights.items():
        check_choice("sim2real/Fish-v0", "reward", name, ("approach", "energy", "bonus"))
        if (finite_number(weight) or 0.0) != weight or weight < 0:
            expected = "a finite number of at least 0"
            raise InputError("sim2real/Fish-v0", f"weight of {name}", repr(weight), expected)
    fish = robot if isinstance(robot, Robot) else read_robot(robot)
    fitted = model if isinstance(model, Model) else read_model(model)
    drawn = ranges if ranges is None or isinstance(ranges, Ranges) else read_ranges(ranges)
    return make_world(
        fish, replace(task, **weights), draws_of(fitted, drawn, fish, seed), n_envs=n_envs,
        fidelity=fidelity, device=device, cell_m=cell_m, seed=seed,
    )  # fmt: skip


def make_world(
    robot: Robot,
    task: Task,
    draws: Draws | Sequence[Draws],
    *,
    n_envs: int,
    fidelity: Fidelity = "twin",
    device: str = "cpu",
    cell_m: float = 0.02,
    seed: int = 0,
    threads: int = 1,
    around: Callable[[Simulator], Simulator] = lambda simulator: simulator,
    **options: Any,  # noqa: ANN401 - those of Twin or Swimmer
) -> World:
    """A world of robots in the fluid or in its twin; arguments as for ``World`` and ``world_of``.

    On CUDA all work goes to PyTorch's current stream, which must not be the default one: see
    ``own_stream``. ``around`` wraps the simulator, to add errors that it does not have.
    """
    check_choice("make_world", "fidelity", fidelity, get_args(Fidelity))
    if device != "cpu":
        if not torch.cuda.is_available():
            raise InputError("train", "--device", device, "a CUDA device, and PyTorch finds none")
        use_stream(device, torch.cuda.current_stream(device).cuda_stream)
    blocks = [draws] if isinstance(draws, Draws) else list(draws)
    models = [blocks[e * len(blocks) // n_envs].models[0] for e in range(n_envs)]
    options |= {"n_envs": n_envs, "device": device, "threads": threads}
    simulator: Simulator
    if fidelity == "twin":
        from sim.twin.twin import Twin

        simulator = Twin(robot, models, **options)
    else:
        from sim.robot.swimmer import Swimmer

        simulator = Swimmer(robot, models, cell_m=cell_m, **options)
    return World(around(simulator), task, blocks, seed)


def noise_of(ranges: Ranges, joints: Sequence[str]) -> Noise:
    """The measurement noise in the ranges; InputError if it is of a joint that there is not."""
    for entry in ranges.entries:
        joint, _, quantity = entry.parameter.partition(".")
        if quantity == "position_noise_rad" and joint not in joints:
            expected = f"a joint of the robot: {', '.join(joints)}"
            raise InputError("ranges", entry.parameter, f"joint {joint}", expected)

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
    """Models for n episodes: values drawn from each range, or rows of a posterior ``sample``."""
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
    density = normalised_density(robot).value.tolist()
    return replace(model, body={**model.body, "normalised_density": density})


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
