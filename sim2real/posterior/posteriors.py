"""The posteriors of all servos of a robot, their joint sample and its file ``posterior.npz``."""

from __future__ import annotations

import io
import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sim2real.arrays import Array
from sim2real.display import NotebookDisplay, from_report
from sim2real.errors import InputError, library
from sim2real.inference.normal import LEVEL
from sim2real.output import write_whole
from sim2real.posterior.servo import PredictiveCheck, ServoPosterior
from sim2real.structured import read_arrays

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMAT = "sim2real.posterior/1"
MOST_DRAWS = 4000


@dataclass(frozen=True)
class JointSample:
    """Draws of all parameters of a robot's servos."""

    names: tuple[str, ...]  # ``J.kp_Nm_per_rad``, ``J.EFFECT.PARAMETER`` and so on, P of them
    units: tuple[str, ...]  # their units, SI
    values: Array  # the draws, shape (N, P), one per row


@dataclass(frozen=True)
class Posteriors(NotebookDisplay):
    """Posteriors of a robot's servos.

    Attributes:
        joints: The posterior of each joint that moved.
        checks: Posterior predictive check of each joint on the held-out recording, if there is one.
        seed: Seed of the chains.
    """

    joints: Mapping[str, ServoPosterior]
    checks: Mapping[str, PredictiveCheck]
    seed: int = 0

    def sample(self) -> JointSample:
        """Draws of all parameters of all joints, one row per draw, as in ``posterior.npz``."""
        return joint_sample(self.joints, np.random.default_rng(self.seed))

    def to_arviz(self) -> Any:  # noqa: ANN401 - ArviZ is not a dependency
        """ArviZ's ``InferenceData``: variables ``J.PARAMETER``, one chain per walker.

        Units are attributes of the variables. The last draws of each joint are used, as many as the
        shortest chain has. Needs the extra ``arviz``, and the same number of walkers in all joints.
        """
        arviz = library("arviz", "to_arviz")
        columns, units = {}, {}
        for joint, servo in self.joints.items():
            values = servo.values.reshape(-1, servo.chain.accepted.size, len(servo.names))
            for k, prior in enumerate(servo.parameters):
                columns[f"{joint}.{prior.name}"] = values[:, :, k].T
                units[f"{joint}.{prior.name}"] = prior.unit
        if len({column.shape[0] for column in columns.values()}) > 1:
            raise ValueError("the joints were sampled with different numbers of walkers")
        draws = min(column.shape[1] for column in columns.values())
        drawn = {name: column[:, -draws:] for name, column in columns.items()}
        old = arviz.__version__.startswith("0.")
        data = arviz.from_dict(posterior=drawn) if old else arviz.from_dict({"posterior": drawn})
        for name, unit in units.items():
            data.posterior[name].attrs["units"] = unit
        return data

    def plot(self, joint: str | None = None) -> Figure:
        """Marginals of one joint (the first by default), and of every pair of parameters."""
        name = next(iter(self.joints), "") if joint is None else joint
        if name not in self.joints:
            raise InputError("plot", "joint", repr(name), f"one of {', '.join(self.joints)}")
        figure: Figure = from_report("ranges.corner_figure")(self.joints[name], name)
        return figure


def joint_sample(servos: Mapping[str, ServoPosterior], rng: np.random.Generator) -> JointSample:
    """Draws of all joints, in random order and as many as the shortest chain has, 4000 at most.

    Posteriors of joints are independent; correlations within a joint are preserved.
    """
    count = min([MOST_DRAWS, *(servo.values.shape[0] for servo in servos.values())])
    columns = [
        servo.values[rng.permutation(servo.values.shape[0])[:count]] for servo in servos.values()
    ]
    return JointSample(
        names=tuple(f"{joint}.{name}" for joint, servo in servos.items() for name in servo.names),
        units=tuple(prior.unit for servo in servos.values() for prior in servo.parameters),
        values=np.concatenate(columns, axis=1),
    )


def write_sample(
    sample: JointSample, path: str | os.PathLike[str], interval_level: float = LEVEL
) -> None:
    """Write ``posterior.npz``: ``names``, ``units``, ``sample`` (float32), ``interval_level``."""
    stream = io.BytesIO()
    np.savez_compressed(
        stream,
        format=np.array(FORMAT),
        names=np.array(sample.names),
        units=np.array(sample.units),
        sample=sample.values.astype(np.float32),
        interval_level=np.array(interval_level),
    )
    write_whole(path, stream.getvalue())


def read_sample(path: str | os.PathLike[str]) -> JointSample:
    """Read ``posterior.npz``; InputError if it is not such a file."""
    content = read_arrays(path, "a posterior.npz", what="sample")
    for name in ("format", "names", "units", "sample"):
        if name not in content:
            raise InputError(path, name, "nothing", "a posterior.npz, which has it")
    if str(content["format"]) != FORMAT:
        raise InputError(path, "format", str(content["format"]), FORMAT)
    names, units = (tuple(str(x) for x in content[n].ravel()) for n in ("names", "units"))
    values = content["sample"]
    shaped = values.ndim == 2 and len(values) and values.shape[1] == len(names) == len(units)
    if not shaped or values.dtype.kind != "f" or not np.isfinite(values).all():
        found = f"{values.dtype} of shape {values.shape}, {len(names)} names, {len(units)} units"
        raise InputError(path, "sample", found, "rows of finite numbers, one for each name")
    return JointSample(names, units, values.astype(np.float64))
