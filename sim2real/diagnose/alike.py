"""Which robots may share a batch: its noise model has one memory, in samples, for all of them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from sim2real.recording import Recording

Progress = Callable[[float], None]

_FACTOR = 1.25
"""Sampling periods that differ by less than about that are alike."""


def sampled_alike(
    robots: Sequence[Sequence[Recording]], progress: Progress
) -> Iterator[tuple[list[int], Progress]]:
    """Places of the robots, given as their recordings, in groups of like sampling period.

    Each group comes with what to call with the share of it that is done.
    """
    groups: dict[int, list[int]] = defaultdict(list)
    for k, recordings in enumerate(robots):
        steps = np.concatenate([np.diff(recording.t) for recording in recordings])
        period = float(np.median(steps)) if steps.size else 1.0
        groups[round(np.log(period) / np.log(_FACTOR))].append(k)
    done = 0
    for group in groups.values():

        def step(share: float, before: int = done, size: int = len(group)) -> None:
            progress((before + size * share) / len(robots))

        yield group, step
        done += len(group)
