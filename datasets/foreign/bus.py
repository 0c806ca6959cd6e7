"""The bus from the computer to the servos: packets are lost, come late, or overtake each other.

Losses in bursts follow the chain of two states of Gilbert, Bell Syst. Tech. J. 39 (1960) 1253, and
Elliott, ibid. 42 (1963) 1977: every packet is lost in the bad state, none in the good one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.special import gammaincinv, ndtr

Array = NDArray[np.float64]

BURST_PACKETS = 2.0, 6.0
CORRELATION_PACKETS = 2.0, 6.0
DELAYS = {"uniform": 0.5, "gamma": 0.25, "exponential": 0.25}
"""Distributions of the added delay, each with the share of buses that have it."""
GAMMA_SHAPE = 2.0


@dataclass(frozen=True)
class Bus:
    """How packets travel.

    Attributes:
        common_packet: One packet carries the commands of all joints (a synchronous write).
            Otherwise each joint has packets of its own, with independent events at the same rates.
        burst_packets: Mean number of packets that are lost in a row; 0 if losses are independent.
        delay: Distribution of the added delay: a key of ``DELAYS``.
        correlation_packets: Number of packets after which the autocorrelation of the delay (before
            its transformation from a Gaussian) has fallen to 1/e; 0 if delays are independent.
        in_order: A late packet holds back those behind it. Otherwise packets overtake, and a servo
            applies an older command that arrives later.
    """

    common_packet: bool = True
    burst_packets: float = 0.0
    delay: str = "uniform"
    correlation_packets: float = 0.0
    in_order: bool = True


@dataclass(frozen=True)
class Packets:
    """The random numbers of T packets to each of J joints.

    Attributes:
        bus: The bus that they travel on.
        delay: Added delay in standard deviations, mean 0, shape (T, J).
        chance: Uniform in 0 to 1, decides on losses, shape (T, J).
    """

    bus: Bus
    delay: Array
    chance: Array

    def lost(self, joint: int, probability: float) -> NDArray[np.bool_]:
        """Which packets to a joint are lost, shape (T,).

        The chain turns bad with probability p / ((1 - p) L) and good with 1 / L, where p is the
        long-run ``probability`` of a loss and L the mean length of a burst.
        """
        chance = self.chance[:, joint]
        if self.bus.burst_packets == 0 or probability == 0:
            return np.asarray(chance < probability)
        turns_bad = probability / ((1 - probability) * self.bus.burst_packets)
        stays_bad = 1 - 1 / self.bus.burst_packets
        out, threshold = np.empty(chance.size, dtype=bool), probability
        for k, number in enumerate(chance.tolist()):
            out[k] = number < threshold
            threshold = stays_bad if out[k] else turns_bad
        return out

    def delivered(
        self, arrival: Array, joint: int, probability: float
    ) -> tuple[NDArray[np.intp], Array]:
        """Which packets a joint receives, as it receives them, and when.

        Args:
            arrival: When each packet would arrive if no other were on the bus, s, shape (T,).
            joint: Index of the joint.
            probability: Long-run probability of a loss.

        Returns:
            Indices of the R packets that are received, and their times of arrival, s, in order of
            arrival.
        """
        received = np.flatnonzero(~self.lost(joint, probability))
        if self.bus.in_order:
            return received, np.maximum.accumulate(arrival[received])
        received = received[np.argsort(arrival[received], kind="stable")]
        return received, arrival[received]


def draw_bus(rng: np.random.Generator) -> Bus:
    """A bus; each of its properties is drawn independently."""
    bursts, correlated = rng.random(2) < 0.5
    return Bus(
        common_packet=bool(rng.random() < 0.5),
        burst_packets=float(rng.uniform(*BURST_PACKETS)) if bursts else 0.0,
        delay=str(rng.choice(list(DELAYS), p=list(DELAYS.values()))),
        correlation_packets=float(rng.uniform(*CORRELATION_PACKETS)) if correlated else 0.0,
        in_order=bool(rng.random() < 0.5),
    )


def draw_packets(bus: Bus, count: int, joints: int, rng: np.random.Generator) -> Packets:
    """The random numbers of ``count`` packets to each of ``joints`` joints."""
    shape = (count, 1 if bus.common_packet else joints)
    normal = rng.normal(size=shape)
    if bus.correlation_packets:
        keep = np.exp(-1 / bus.correlation_packets)
        normal[1:] *= np.sqrt(1 - keep**2)
        normal = lfilter([1.0], [1.0, -keep], normal, axis=0)
    delay, chance = _standardised(bus.delay, ndtr(normal)), rng.random(shape)
    return Packets(bus, *(np.broadcast_to(x, (count, joints)) for x in (delay, chance)))


def _standardised(distribution: str, quantile: Array) -> Array:
    """Values of a distribution at ``quantile``, scaled to mean 0 and standard deviation 1."""
    if distribution == "uniform":
        return np.sqrt(3) * (2 * quantile - 1)
    if distribution == "gamma":
        return (gammaincinv(GAMMA_SHAPE, quantile) - GAMMA_SHAPE) / np.sqrt(GAMMA_SHAPE)
    return -np.log1p(-quantile) - 1
