"""What the answers say of the bus of a case: how it is, and when each of its events happened."""

from __future__ import annotations

from typing import Any

import numpy as np
from bench import JOINTS
from foreign_cases import ForeignCase
from foreign_world import acting_on, deliveries
from numpy.typing import NDArray


def bus_answer(case: ForeignCase) -> dict[str, Any]:
    """The bus of a case with lost packets or jitter; empty for others, whose bus is perfect.

    Returns:
        The properties of the bus, the long-run probability of a loss, the mean number of packets
        that are lost in a row, the standard deviation of the added delay in s, the mean and the
        standard deviation of the delay from sending to arrival by joint in s (waiting in the queue
        included), and ``events`` by recording and joint: ``lost_s``, when each lost packet was
        sent; ``overtaken_s``, when each packet was sent that arrived after a newer one; with jitter
        ``delay_s``, the delay of each packet of the recording, None if it was lost.
    """
    acting = acting_on(case.hidden, 0)
    loss, jitter = acting.get("packet_loss"), acting.get("latency_jitter")
    if not (loss or jitter):
        return {}
    bus = case.takes["a"].packets.bus
    probability = loss["probability"] if loss else 0.0
    halfwidth = jitter["halfwidth_s"] if jitter else 0.0
    delays = {
        recording: [_delays(case, recording, j) for j in range(len(case.servos))]
        for recording in case.takes
    }
    of_joint = dict(
        zip(JOINTS, (np.concatenate(x) for x in zip(*delays.values(), strict=True)), strict=False)
    )
    return {
        "packets": "common" if bus.common_packet else "separate",
        "order": "queued" if bus.in_order else "overtaking",
        "losses": "bursts" if bus.burst_packets else "independent",
        "loss_probability": probability,
        "burst_packets": bus.burst_packets or 1 / (1 - probability),
        "delay": bus.delay,
        "delay_correlation_packets": bus.correlation_packets,
        "added_delay_standard_deviation_s": halfwidth / np.sqrt(3),
        "delay_mean_s": {j: float(np.nanmean(x)) for j, x in of_joint.items()},
        "delay_standard_deviation_s": {j: float(np.nanstd(x)) for j, x in of_joint.items()},
        "events": {
            recording: {
                joint: _events(case.takes[recording].t, delay, every_delay=bool(jitter))
                for joint, delay in zip(JOINTS, by_joint, strict=False)
            }
            for recording, by_joint in delays.items()
        },
    }


def _delays(case: ForeignCase, recording: str, joint: int) -> NDArray[np.float64]:
    """Delay of each packet from sending to arrival, s, shape (T,); NaN if it is lost."""
    take, acting = case.takes[recording], acting_on(case.hidden, joint)
    received, arrival = deliveries(take, joint, case.servos[joint].latency_s, acting)
    delay = np.full(take.t.size, np.nan)
    delay[received] = arrival - take.t[received]
    return delay


def _events(
    sent: NDArray[np.float64], delay: NDArray[np.float64], *, every_delay: bool
) -> dict[str, list[float | None]]:
    """Losses and overtaken packets of one joint by the time of sending; ``delay`` as in _delays."""
    lost = np.isnan(delay)
    arrival = np.where(lost, np.inf, sent + delay)
    earliest_newer = np.append(np.minimum.accumulate(arrival[::-1])[::-1][1:], np.inf)
    overtaken = ~lost & (arrival > earliest_newer)
    events: dict[str, list[float | None]] = {
        "lost_s": sent[lost].tolist(),
        "overtaken_s": sent[overtaken].tolist(),
    }
    if every_delay:
        events["delay_s"] = [None if np.isnan(x) else round(x, 5) for x in delay.tolist()]
    return events
