"""Whether the set-points of a robot arrive unevenly or get lost on the way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from sim2real.diagnose.arrival_jitter import latency_jitter
from sim2real.diagnose.arrival_loss import packet_loss
from sim2real.diagnose.arrival_noise import hear
from sim2real.diagnose.arrival_response import Residual
from sim2real.diagnose.processes import spread

NOTICED = 10.0
"""Gain in log-likelihood from which an uneven link is a finding."""


@dataclass(frozen=True)
class Link:
    """What an uneven link explains of what a robot's fits leave.

    Attributes:
        effect: ``latency_jitter`` or ``packet_loss``, whichever explains more.
        gain: Log-likelihood that it gains; 0 where nothing is found.
        value: The effect's parameter.
        sd: Its standard deviation.
        shares: Gain at each joint by itself.
    """

    effect: str
    gain: float
    value: float
    sd: float
    shares: tuple[float, ...]


@dataclass(frozen=True)
class Listened:
    """Residuals of one robot's fits: for each joint its recordings, and what the noise may be."""

    joints: tuple[tuple[Residual, ...], ...]
    lags: int
    least_gain: float


def links(robots: Sequence[Listened]) -> list[Link]:
    """Listen to every robot."""
    return spread(_link, robots)


def _link(robot: Listened) -> Link:
    heard = [hear(joint, robot.lags, robot.least_gain) for joint in robot.joints]
    late = latency_jitter(heard)
    nothing = Link("latency_jitter", 0.0, 0.0, 0.0, tuple(0.0 for _ in heard))
    sizes = {sum(one.t.size for one in joint) for joint in robot.joints}
    lost = packet_loss(heard, broadcast=len(sizes) == 1)
    if max(late.gain, lost.gain) < NOTICED:
        return nothing
    if lost.gain > late.gain:
        shares = tuple(packet_loss([joint]).gain for joint in heard)
        return Link("packet_loss", lost.gain, lost.probability, lost.sd, shares)
    shares = tuple(latency_jitter([joint]).gain for joint in heard)
    return Link("latency_jitter", late.gain, late.halfwidth_s, late.sd_s, shares)
