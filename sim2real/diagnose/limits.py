"""How small an effect a recording could have shown."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.result import DetectionLimit
from sim2real.diagnose.screen import Candidate, Screen

Array = NDArray[np.float64]

_NINE_IN_TEN = 1.28


def detection_limits(
    seen: Screen, candidates: Sequence[Candidate], component: str
) -> list[DetectionLimit]:
    """The smallest strength of each effect that could be noticed.

    The score of an effect grows with its strength; between the strengths that were simulated it is
    interpolated, both on logarithmic scales.

    Args:
        seen: What every start of every candidate would leave in the innovations.
        candidates: The candidates, as the screen counts them.
        component: The joint.
    """
    needed = float(np.sqrt(2 * DECISION.detection_gain)) + _NINE_IN_TEN
    limits = []
    for k, option in enumerate(candidates):
        mine = seen.candidate == k
        strength = np.abs(option.starts[seen.start[mine], 0])
        visible = seen.visible[mine]
        name = option.effect.parameters[0].name
        limits.append(
            DetectionLimit(
                option.effect.name, component, {name: _crossing(strength, visible, needed)}
            )
        )
    return limits


def _crossing(strength: Array, visible: Array, needed: float) -> float | None:
    """Strength at which the score reaches what is needed; None where no start does."""
    levels = np.unique(strength)
    score = np.array([np.median(visible[strength == level]) for level in levels])
    shown = np.flatnonzero(score >= needed)
    if not shown.size:
        return None
    weaker_is_larger = score[0] > score[-1]
    at = int(shown[-1] if weaker_is_larger else shown[0])
    beyond = at + 1 if weaker_is_larger else at - 1
    if not 0 <= beyond < levels.size or score[beyond] <= 0:
        # Beyond the strengths tried the score is taken as proportional.
        ratio = needed / score[at]
        return float(levels[at] / ratio if weaker_is_larger else levels[at] * ratio)
    place = np.interp(
        np.log(needed),
        np.sort(np.log(score[[at, beyond]])),
        np.log(levels[[at, beyond]])[np.argsort(score[[at, beyond]])],
    )
    return float(np.exp(place))
