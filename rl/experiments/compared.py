"""Simulation beside reality: signals of a swim, and stills and frames of films."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rl.experiments.film import MARGIN_M
from rl.task import DOMAIN_M
from sim.inference.swims import Swim
from sim.view.video import FRAMES_PER_S
from sim2real.arrays import Array, Picture
from sim2real.report.drawing import INK, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Compared:
    """A recorded swim and its simulation: signals (T, 3 + J) as ``Swim.signals``, heading (T,)."""

    swim: Swim
    signals: Array
    heading: Array

    def rows(self) -> dict[str, tuple[Array, Array]]:
        """Measured and simulated surge, sway, yaw and first joint, by label."""
        pairs = [(self.swim.signals[:, k], self.signals[:, k]) for k in (0, 1, 3)]
        yaw = (self.swim.heading - self.swim.start[2], self.heading - self.swim.start[2])
        labels = ("surge (m/s)", "sway (m/s)", "yaw (rad)", "joint 1 (rad)")
        return dict(zip(labels, [*pairs[:2], yaw, pairs[2]], strict=True))

    def errors(self) -> dict[str, float]:
        """Root mean square error of each row."""
        return {
            label: float(np.sqrt(np.nanmean(np.square(measured - simulated))))
            for label, (measured, simulated) in self.rows().items()
        }


def compared_figure(swims: Sequence[Compared]) -> Figure:
    """A column for each swim, with surge, sway, yaw and the first joint, coloured as in Fig. 3."""
    with new_figure(580, "Measured and simulated swims") as figure:
        panels = figure.subplots(4, len(swims), squeeze=False, sharex="col", sharey="row")
        for column, one in zip(panels.T, swims, strict=True):
            t = one.swim.t
            for axes, (label, pair) in zip(column, one.rows().items(), strict=True):
                if label.startswith("joint"):
                    axes.plot(t, one.swim.command[:, 0], color=INK, lw=0.6, label="command")
                axes.plot(t, pair[0], color="tab:red", lw=1.0, label="measured")
                axes.plot(t, pair[1], "--", color="tab:blue", lw=1.2, label="simulated")
                axes.set_title(label)
            column[0].set_title(one.swim.name, loc="right", color=INK)
            column[-1].set_xlabel("time (s)")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside upper left", ncols=3)
    return figure


def stills_figure(
    reels: Mapping[str, Sequence[Picture]], ways: Sequence[Array], target: Array, count: int = 6
) -> Figure:
    """Stills of films from above at the same times, a row for each, around paths and target."""
    points = np.concatenate([*ways, target[None]])
    low, high = np.nanmin(points, axis=0) - 0.3, np.nanmax(points, axis=0) + 0.3
    last = max(len(reel) for reel in reels.values()) - 1
    width, height = high - low
    tall = 680 / count * height / width
    with new_figure(60 + (tall + 30) * len(reels), "Stills of the turn") as figure:
        panels = figure.subplots(len(reels), count, squeeze=False)
        ends = np.array([-1, 1, -1, 1]) * (DOMAIN_M[0] / 2 + MARGIN_M)
        for row, (name, reel) in zip(panels, reels.items(), strict=True):
            for axes, k in zip(row, np.linspace(0, last, count).round().astype(int), strict=True):
                axes.imshow(reel[min(k, len(reel) - 1)], extent=ends)
                axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xticks=[], yticks=[])
                axes.set_title(f"{k / FRAMES_PER_S:.1f} s", color=INK)
                axes.spines[:].set(visible=True)
            row[0].set_ylabel(name)
    return figure


def in_step(reels: Sequence[Sequence[Picture]]) -> Iterator[Picture]:
    """Frames of films side by side; one that is over keeps its last picture."""
    for k in range(max(len(reel) for reel in reels) + FRAMES_PER_S):  # a second longer
        yield np.hstack([reel[min(k, len(reel) - 1)] for reel in reels])
