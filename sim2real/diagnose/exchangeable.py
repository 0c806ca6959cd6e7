"""Two effects that may exchange their parameters: filters before and behind a linear servo.

The transfer functions of two filters in series commute, so that a servo without friction or limits
responds the same with their time constants x and y exchanged: recordings determine x + y and x y,
and (x - y)^2 = (x + y)^2 - 4 x y. Where x = y the derivatives of the response by x and by y are
equal, and the covariance of a fit says nothing of either.
"""

from __future__ import annotations

import numpy as np

from sim2real.effects import named
from sim2real.identification.servo_problem import Hypothesis, Set, Tried
from sim2real.inference.normal import Z90


def partner(members: Set, effect: str) -> str | None:
    """The effect of a set that may exchange its parameters with this one of it; None without one.

    It is of the same family, acts at another site and has the same parameters.
    """
    one = named(effect)
    for other in sorted(members - {effect}):
        if one.family and named(other).family == one.family:
            names = [[p.name for p in e.parameters] for e in (one, named(other))]
            if names[0] == names[1]:
                return other
    return None


def distinctness(tried: Tried, servo: Hypothesis, effect: str, other: str) -> float:
    """Root of twice the gain in log-likelihood by two effects over the likelier one alone.

    Where only one is present about the size of a standard normal deviate (Wilks, Annals of
    Mathematical Statistics 9 (1938) 60-62).

    Args:
        tried: What was tried on the joint.
        servo: The fit with both effects.
        effect: One of them.
        other: The other.
    """
    fewer = [tried.tried.get(servo.members - {name}, tried.plain) for name in (effect, other)]
    gain = servo.fit.loglikelihood[0] - max(h.fit.loglikelihood[0] for h in fewer)
    return float(np.sqrt(max(2 * gain, 0.0)))


def exchangeable_ends(mean: float, other: float, distinct: float) -> tuple[float, float]:
    """Ends of the 90 % interval of either of two positive parameters that may be exchanged.

    Their sum is taken as known, and their product has a relative standard deviation of
    ``1 / distinct``: it is 0 where one of the effects is absent.

    Args:
        mean: Estimate of one.
        other: Estimate of the other.
        distinct: See ``distinctness``.
    """
    total = mean + other
    square = (mean - other) ** 2 + Z90 * 4 * mean * other / max(distinct, 1e-9)
    apart = min(float(np.sqrt(square)), total)
    return 0.5 * (total - apart), 0.5 * (total + apart)
