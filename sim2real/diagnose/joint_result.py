"""What is known of one joint once it has been diagnosed: its fits and their errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim2real.diagnose.case import Joint
from sim2real.diagnose.heldout import Unseen
from sim2real.diagnose.investigate import Finding
from sim2real.diagnose.search import Hypothesis, Set
from sim2real.diagnose.unmodelled import WANDER
from sim2real.inference.holdout import rms

Array = NDArray[np.float64]


@dataclass(frozen=True)
class JointResult:
    """One joint.

    Attributes:
        joint: Its recordings.
        finding: What it is missing.
        rich: The servo with what is named.
        before: Simulated minus measured angles of the plain servo in rad, shape (R, T).
        after: Those of the enriched one.
        least_squares: Parameters of the plain servo by least squares, shape (P,).
        unseen: Errors on held-out data, by the effects that a servo has; empty where nothing can be
            held out.
    """

    joint: Joint
    finding: Finding
    rich: Hypothesis
    before: Array
    after: Array
    least_squares: Array
    unseen: Mapping[Set, Unseen]

    @property
    def name(self) -> str:
        """Of the joint."""
        return self.joint.name

    @property
    def signal(self) -> str:
        """Of the joint's angle."""
        return f"{self.name}.position_rad"

    @property
    def richer(self) -> bool:
        """Whether anything was added to the plain servo."""
        return self.rich.members != self.finding.tried.base

    @property
    def unseen_plain(self) -> Unseen | None:
        """Errors of the plain servo on held-out data."""
        return self.unseen.get(self.finding.tried.base)

    @property
    def error(self) -> float:
        """Of the plain servo on held-out data, or on the fitted where nothing is held out, rad."""
        return self.unseen_plain.rmse if self.unseen_plain else self._train(self.before)

    def fit(self, *, enriched: bool) -> dict[str, float | None]:
        """Errors on fitted and on held-out data, rad."""
        members = self.rich.members if enriched else self.finding.tried.base
        unseen = self.unseen.get(members)
        train = self._train(self.after if enriched else self.before)
        return {"train": train, "heldout": None if unseen is None else unseen.rmse}

    def heldout(self) -> dict[str, float | None]:
        """Errors on held-out data, and the share of the removable that is removed."""
        plain, rich = self.unseen_plain, self.unseen.get(self.rich.members)
        if plain is None or rich is None:
            return {"rmse_before": None, "rmse_after": None, "recoverable_removed": None}
        # A sensor may wander slowly; no model removes that.
        noise = min(self.joint.noise * np.sqrt(1 + WANDER.share**2), plain.rmse)
        removable = plain.rmse - noise
        removed = (plain.rmse - rich.rmse) / removable if removable > 0 else 0.0
        return {
            "rmse_before": plain.rmse,
            "rmse_after": rich.rmse,
            "recoverable_removed": float(np.clip(removed, -1.0, 1.0)),
        }

    def changes(self, effect: str) -> float:
        """Share by which an effect lowers the held-out error beside the others; or infinity.

        Infinity where that cannot be told: of chance and of rounding, which nobody can foretell,
        and where nothing is held out.
        """
        rich = self.unseen.get(self.rich.members)
        without = self.unseen.get(self.rich.members - {effect}, self.unseen_plain)
        if effect not in self.rich.members or rich is None or without is None:
            return float("inf")
        return 1 - rich.rmse / without.rmse

    def _train(self, residual: Array) -> float:
        pairs = zip(residual, self.joint.traces, strict=False)
        return rms([row[: t.t.size][t.used] for row, t in pairs])
