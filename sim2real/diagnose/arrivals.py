"""Set-points that arrive unevenly or not at all: is it in what a plain fit leaves, how strongly?

A delay of one set-point or its loss is a random event of its own, so that no refit reproduces it.
But what it does to the angle is known, a short response in proportion to the change of the
set-point, and the sum of all such responses is found in the residual by its likelihood.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from sim2real.diagnose.arrival_jitter import Jitter, latency_jitter
from sim2real.diagnose.arrival_loss import Loss, packet_loss
from sim2real.diagnose.arrival_noise import hear
from sim2real.diagnose.arrival_response import Residual

__all__ = ["Arrivals", "Jitter", "Loss", "Residual", "arrivals"]


@dataclass(frozen=True)
class Arrivals:
    """What uneven or missing set-points would explain, each on its own.

    Attributes:
        jitter: Latency jitter.
        loss: Packet loss.
    """

    jitter: Jitter
    loss: Loss


def arrivals(
    joints: Sequence[Sequence[Residual]],
    *,
    lags: int,
    least_gain: float,
    broadcast: bool = False,
) -> Arrivals:
    """Weigh latency jitter and packet loss on one link.

    Gains are over independent noise of the same kind, an autoregression refitted to the residual
    whose innovations may be smaller at rest, and with small changes of latency, kp and kd for free
    on both sides.

    Args:
        joints: What the plain fit leaves of each joint on the link, recording by recording; one
            joint alone is a list of one.
        lags: Order of the autoregression, as in ``Batch.lags``.
        least_gain: Least gain of the whitening filter at frequency 0, as in ``Batch.least_gain``.
        broadcast: Whether a set-point is lost for all joints at once. They must then have the same
            recordings.

    Raises:
        ValueError: If a joint has too few samples that count, or if joints of a broadcast have
            different numbers of set-points.
    """
    heard = [hear(recordings, lags, least_gain) for recordings in joints]
    return Arrivals(latency_jitter(heard), packet_loss(heard, broadcast=broadcast))
