"""The likelier of the two effects on the link of each robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from sim2real.diagnose.decision import DECISION
from sim2real.diagnose.link.angle_noise import with_noise
from sim2real.diagnose.link.jitter import latency_jitter
from sim2real.diagnose.link.lost_packets import Uneven, packet_loss
from sim2real.processes import shared
from sim2real.servo.linearised import Residual


@dataclass(frozen=True)
class LinkData:
    """Residuals of one robot's fits: for each joint its recordings, and what the noise may be."""

    joints: tuple[tuple[Residual, ...], ...]
    lags: int
    least_gain: float
    noticed: float = 0.0


def links(robots: Sequence[LinkData]) -> list[Uneven]:
    """The likelier of the two effects on every robot's link; ``gain`` 0 below what is noticed."""
    return shared(link, robots)


def link(robot: LinkData) -> Uneven:
    """The likelier of the two effects on one robot's link."""
    joints = [with_noise(joint, robot.lags, robot.least_gain) for joint in robot.joints]
    worth = DECISION.link.negligible_gain if robot.noticed else 0.0
    found = max(latency_jitter(joints, worth), packet_loss(joints), key=lambda x: x.gain)
    samples = sum(joint.counts[0] for joint in joints)
    if found.gain < max(robot.noticed, worth * samples):
        return Uneven(found.effect, shares=tuple(0.0 for _ in joints))
    late = found.effect == "latency_jitter"
    alone = [latency_jitter([one], worth) if late else packet_loss([one]) for one in joints]
    return replace(found, shares=tuple(one.gain for one in alone))
