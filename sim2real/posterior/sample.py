"""The sample of all joints together: the file that keeps correlations, and ArviZ's form."""

from __future__ import annotations

import io
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from sim2real.errors import InputError
from sim2real.output import write_whole
from sim2real.posterior.servo import ServoPosterior

Array = NDArray[np.float64]

FORMAT = "sim2real.posterior/1"
MOST_DRAWS = 4000


@dataclass(frozen=True)
class JointSample:
    """Draws of all parameters of a robot's servos.

    Attributes:
        names: ``J.kp_Nm_per_rad``, ``J.EFFECT.PARAMETER`` and so on, P of them.
        units: Their units, SI.
        values: The draws, shape (N, P); parameters in one row belong together.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array


def joint_sample(found: Mapping[str, ServoPosterior], rng: np.random.Generator) -> JointSample:
    """Draws of all joints, in random order and as many as the shortest chain has, 4000 at most.

    Joints are sampled by themselves and depend on each other by nothing, so that any draw of one
    goes with any draw of another; within a joint, correlations stay.
    """
    count = min([MOST_DRAWS, *(one.values.shape[0] for one in found.values())])
    columns = [one.values[rng.permutation(one.values.shape[0])[:count]] for one in found.values()]
    return JointSample(
        names=tuple(f"{joint}.{name}" for joint, one in found.items() for name in one.names),
        units=tuple(prior.unit for one in found.values() for prior in one.priors.each),
        values=np.concatenate(columns, axis=1),
    )


def write_sample(sample: JointSample, path: str | os.PathLike[str]) -> None:
    """Write ``posterior.npz``: ``names``, ``units`` and ``sample``; without pickle.

    Raises:
        InputError: If the folder can't be written.
    """
    stream = io.BytesIO()
    np.savez_compressed(
        stream,
        format=np.array(FORMAT),
        names=np.array(sample.names),
        units=np.array(sample.units),
        sample=sample.values,
    )
    write_whole(path, stream.getvalue())


def read_sample(path: str | os.PathLike[str]) -> JointSample:
    """Read ``posterior.npz``.

    Raises:
        InputError: If it is no such file.
    """
    try:
        with np.load(Path(path), allow_pickle=False) as content:
            if str(content["format"]) != FORMAT:
                raise InputError(path, "format", str(content["format"]), FORMAT)
            names, units = (tuple(str(x) for x in content[n]) for n in ("names", "units"))
            return JointSample(names, units, content["sample"])
    except (OSError, ValueError, KeyError, EOFError, BadZipFile) as error:
        raise InputError(path, "", f"no sample ({error})", "a posterior.npz") from None


def to_inference_data(found: Mapping[str, ServoPosterior]) -> Any:  # noqa: ANN401 - ArviZ's
    """Posteriors of servos as ArviZ's ``InferenceData``: a chain a walker.

    Variables are named ``J.PARAMETER`` and have their unit as an attribute. Joints are sampled by
    themselves; of each the last draws are taken, as many as the shortest chain has.

    Raises:
        ModuleNotFoundError: If ArviZ is not installed.
        ValueError: If the joints were sampled with different numbers of walkers.
    """
    import arviz  # an extra: pip install sim2real[arviz]

    columns, units = {}, {}
    for joint, one in found.items():
        values = one.values.reshape(-1, one.chain.accepted.size, len(one.names))
        for k, prior in enumerate(one.priors.each):
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
