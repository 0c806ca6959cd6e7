"""A policy as a file of arrays, its evaluation, and a controller of it, with NumPy only."""

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rl.observer import PAPER, Observer, View
from sim2real.arrays import Array32
from sim2real.errors import InputError
from sim2real.structured import finite_number, read_arrays

SCHEMA = "sim2real.policy/2"
FIRST = "sim2real.policy/1"
"""Former schema without a view, which is that of the paper."""
LARGEST_BYTES = 64 * 2**20
"""Largest unpacked file; a policy of four layers of 256 has 8 MB with its critics."""


@dataclass(frozen=True)
class Policy:
    """A fully connected network with ReLU between layers and tanh at the output."""

    # of each layer, shapes (outputs, inputs) and (outputs,)
    weights: tuple[Array32, ...]
    biases: tuple[Array32, ...]
    # angles in rad of the outputs -1 and 1, shape (J,)
    low: Array32
    high: Array32
    joints: tuple[str, ...]  # names of the J joints, in the order of the action
    # names of the O columns of the task's observation, with units, in order
    observation: tuple[str, ...]
    observation_limit: Array32  # magnitude that each column was clipped to in training, shape (O,)
    # definition of the observations; its F columns are the inputs of the network
    view: View = PAPER
    # provenance; ``trained_over`` has the 5 % and 95 % quantile of each parameter of the robots
    # that it was trained with
    provenance: Mapping[str, Any] = field(default_factory=dict)


def forward(policy: Policy, inputs: NDArray[Any]) -> Array32:
    """Decisions of SAC's actor, tanh of the mean, (..., J), from columns of the view (..., F)."""
    x = np.asarray(inputs, dtype=np.float32)
    *hidden, (weight, bias) = zip(policy.weights, policy.biases, strict=True)
    for W, b in hidden:
        x = np.maximum(x @ W.T + b, np.float32(0))
    return np.asarray(np.tanh(x @ weight.T + bias), dtype=np.float32)


class PolicyController:
    """The mean action of a policy, with the observer of its training, for any number of robots."""

    def __init__(self, policy: Policy) -> None:
        self.policy = policy
        self.reset()

    def reset(self) -> None:
        """All robots begin anew."""
        self._observer: Observer | None = None
        self._since = 0

    def act(self, observation: Array32, gone: int = 1) -> Array32:
        """Set-points in rad (E, J) of this period, ``gone`` ones after the last, from (E, O)."""
        policy, period = self.policy, self.policy.view.period
        limit = policy.observation_limit
        clipped = np.clip(np.asarray(observation, dtype=np.float32), -limit, limit)
        self._since += gone
        if fresh := self._observer is None:
            self._observer = Observer(policy.view, policy.low, policy.high, len(clipped))
            self._observer.begin(clipped)
            self._since = 0
        if fresh or self._since >= period:
            self._since %= period
            self._observer.decide(forward(policy, self._observer.observe(clipped)))
        return np.asarray(self._observer.set_points(self._since), dtype=np.float32)


def npz(policy: Policy) -> bytes:
    """The content of ``policy.npz``, readable by ``numpy.load`` without pickle."""
    layers: dict[str, Any] = {}
    for k, (weight, bias) in enumerate(zip(policy.weights, policy.biases, strict=True)):
        layers |= {f"weight_{k}": weight, f"bias_{k}": bias}
    stream = BytesIO()
    np.savez_compressed(
        stream,
        schema=np.array(SCHEMA),
        low_rad=policy.low,
        high_rad=policy.high,
        joints=np.array(policy.joints),
        observation=np.array(policy.observation),
        observation_limit=policy.observation_limit,
        view=np.array(json.dumps(asdict(policy.view))),
        provenance=np.array(json.dumps(dict(policy.provenance))),
        **layers,
    )
    return stream.getvalue()


def read_npz(path: str | os.PathLike[str]) -> Policy:
    """Read ``policy.npz``, whose arrays must be of consistent shapes."""
    file = Path(path)
    content = read_arrays(file, "a policy exported as .npz", largest=LARGEST_BYTES)
    schema = str(content.get("schema"))
    if schema not in (SCHEMA, FIRST):
        raise InputError(file, "schema", repr(schema), repr(SCHEMA))
    try:
        layers = range(sum(name.startswith("weight_") for name in content))
        note = json.loads(str(content["provenance"]))
        if not isinstance(note, dict) or not is_spread(note.get("trained_over", {})):
            raise ValueError("a provenance that is no object, or without two numbers by parameter")
        policy = Policy(
            tuple(_numbers(content[f"weight_{k}"]) for k in layers),
            tuple(_numbers(content[f"bias_{k}"]) for k in layers),
            _numbers(content["low_rad"]),
            _numbers(content["high_rad"]),
            tuple(map(str, content["joints"])),
            tuple(map(str, content["observation"])),
            _numbers(content["observation_limit"]),
            PAPER if schema == FIRST else View.from_content(json.loads(str(content["view"]))),
            note,
        )
    except KeyError as error:
        raise InputError(file, str(error.args[0]), "nothing", "an array of that name") from None
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(file, "", f"an invalid array ({error})", "finite numbers") from None
    _check(file, policy)
    return policy


def is_spread(content: object) -> bool:
    """Whether ``content`` has two finite numbers for each parameter, as ``trained_over`` does."""
    return isinstance(content, dict) and all(
        isinstance(ends, list) and len(ends) == 2 and None not in map(finite_number, ends)
        for ends in content.values()
    )


def _numbers(values: NDArray[Any]) -> Array32:
    with np.errstate(over="ignore"):
        numbers = np.asarray(values, dtype=np.float32)
    if not np.isfinite(numbers).all():
        raise ValueError("not finite")
    return numbers


def _check(file: Path, policy: Policy) -> None:
    """Check the shapes of the layers, from observation to joints."""
    J, columns = len(policy.joints), len(policy.observation)
    width = policy.view.size(J)
    if columns != 5 + 2 * J:
        raise InputError(file, "observation", f"{columns} names", f"{5 + 2 * J}, for {J} joints")
    if not policy.weights:
        raise InputError(file, "weight_0", "nothing", "an array of that name")
    for k, (weight, bias) in enumerate(zip(policy.weights, policy.biases, strict=True)):
        if weight.ndim != 2 or weight.shape[1] != width or bias.shape != weight.shape[:1]:
            shapes = f"the shapes {weight.shape} and {bias.shape}"
            expected = f"(outputs, {width}) and (outputs,)"
            raise InputError(file, f"weight_{k} and bias_{k}", shapes, expected)
        width = weight.shape[0]
    if width != J:
        raise InputError(file, "joints", f"{J} for {width} outputs", "one per output")
    for name, array, length in (
        ("low_rad", policy.low, J),
        ("high_rad", policy.high, J),
        ("observation_limit", policy.observation_limit, columns),
    ):
        if array.shape != (length,):
            raise InputError(file, name, f"the shape {array.shape}", f"({length},)")
