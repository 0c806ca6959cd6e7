"""The posteriors of all servos of a robot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sim2real.display import NotebookDisplay, from_report
from sim2real.errors import InputError
from sim2real.posterior.predictive_check import PredictiveCheck
from sim2real.posterior.sample import JointSample, joint_sample, to_inference_data
from sim2real.posterior.servo import ServoPosterior

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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

        Raises:
            ModuleNotFoundError: If the extra ``arviz`` is not installed.
        """
        return to_inference_data(self.joints)

    def __str__(self) -> str:
        """Median and 90 % interval of each parameter."""
        lines = []
        for joint, sampled in self.joints.items():
            rows = zip(sampled.priors.each, sampled.quantiles(0.05, 0.5, 0.95).T, strict=True)
            lines += [
                f"{joint}.{prior.name:30s} {median:10.4g} {prior.unit:12s} "
                f"90 % {low:.4g} to {high:.4g}"
                for prior, (low, median, high) in rows
            ]
        return "\n".join(lines) or "no joint moved on the bench"

    def plot(self, joint: str | None = None) -> Figure:
        """Marginals of one joint (the first by default), and of every pair of parameters.

        Raises:
            InputError: If that joint was not sampled.
        """
        name = next(iter(self.joints), "") if joint is None else joint
        if name not in self.joints:
            raise InputError("plot", "joint", repr(name), f"one of {', '.join(self.joints)}")
        figure: Figure = from_report("corner_plot.corner_figure")(self.joints[name], name)
        return figure
