"""Paths of policies over the pool."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from rl.experiments.ablation_report import aligned
from sim2real.arrays import Array, Mask

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def paths_figure(policies: Sequence[str], paths: Array, targets: Array, arrived: Mask) -> Figure:
    """Paths in the first realities, a panel for each policy.

    Args:
        policies: Names of the K policies.
        paths: Positions in m, shape (K, n, S, 2); not a number after the end of a trial.
        targets: Waypoints in m, shape (n, W, 2).
        arrived: Whether each trial arrived, shape (K, n); the others are grey.
    """
    from sim2real.report.style import ACCENT, FAINT, INK, MUTED, house_style, new_figure

    rows = -(-len(policies) // 2)
    with house_style():
        figure = new_figure(200 * rows + 20, "Paths over the pool in the first realities")
        panels = figure.subplots(
            rows, min(2, len(policies)), squeeze=False, sharex=True, sharey=True
        )
        for axes in panels.ravel()[len(policies) :]:
            axes.set_visible(False)
        for axes, name, of_policy, won in zip(
            panels.ravel(), policies, paths, arrived, strict=False
        ):
            for path, (target, *_), reached in zip(of_policy, targets, won, strict=True):
                drawn = aligned(path[np.isfinite(path).all(axis=1)], target)
                axes.plot(*drawn.T, color=ACCENT if reached else MUTED, lw=0.7, alpha=0.7)
                away = float(np.linalg.norm(target - path[0]))
                axes.plot([-away], [0], "o", mfc="none", mec=FAINT)
            axes.margins(x=0.04)
            axes.plot([0], [0], "o", color=INK, markersize=3)
            axes.set(aspect="equal", xlabel="m")
            axes.locator_params(nbins=5)
            axes.set_title(name)
    return figure
