"""The picture of calibration and diagnosis on the real fish's page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

Found = dict[str, Any]

_COLOURS = {
    "by the beat": "0.6", "regression": "#7a5195", "uncalibrated": "#b8381d",
    "calibrated": "#19528c", "likeliest effect": "#2f8f6b",
}  # fmt: skip


def draw(found: Found, target: Path) -> None:
    """Speeds of clips left out, errors by signal, one clip over time."""
    figure = plt.figure(figsize=(13, 4.6), layout="constrained")
    parts: Any = figure.subfigures(1, 3, width_ratios=(1, 1.1, 1.5))
    left, middle, right = parts
    _draw_speeds(found, left.subplots())
    _draw_errors(found, middle.subplots())
    _draw_clip(found, right.subplots(3, 1, sharex=True))
    figure.savefig(target, dpi=110)
    plt.close(figure)


def _draw_speeds(found: Found, axes: Any) -> None:  # noqa: ANN401 - matplotlib has no stubs
    measured = [one["speed"] for one in found["measured"]]
    for name, mark in (("uncalibrated", "v"), ("calibrated", "o"), ("by the beat", "x")):
        said = [found["predicted_speed"][clip][name] for clip in found["clips"]]
        axes.plot(measured, said, mark, color=_COLOURS[name], label=name)
    axes.plot([0, 0.25], [0, 0.25], color="0.8", linewidth=1, zorder=0)
    axes.set(xlabel="filmed speed (m/s)", ylabel="predicted, clip left out (m/s)")
    axes.set(xlim=(0, 0.25), ylim=(0, 0.25), aspect="equal")
    axes.legend(frameon=False, fontsize=8)


def _draw_errors(found: Found, axes: Any) -> None:  # noqa: ANN401
    rms = np.mean([one["rms"] for one in found["measured"]], axis=0)
    scale = np.append(rms, rms[0])
    names = [name for name in _COLOURS if name in found["one_left_out"]]
    for k, name in enumerate(names):
        one = found["one_left_out"][name]
        mean, ends = np.array(one["mean"]) / scale, np.array(one["interval"]) / scale
        at = np.arange(4) + 0.14 * (k - (len(names) - 1) / 2)
        axes.errorbar(
            at, mean, np.abs(ends - mean), fmt="o", markersize=4, color=_COLOURS[name],
            label=name, elinewidth=1.2,
        )  # fmt: skip
    floor = np.array(found["noise"]["jitter of the tracker"]["mean"]) / scale
    axes.hlines(floor[:3], np.arange(3) - 0.4, np.arange(3) + 0.4, color="0.3", linestyle=":")
    axes.set_xticks(range(4), found["measures"])
    axes.set(ylabel="error, clip left out / film's root mean square", ylim=(0, None))
    axes.legend(frameon=False, fontsize=8)


def _draw_clip(found: Found, panels: Sequence[Any]) -> None:
    film = found["film"]
    for k, (axes, unit) in enumerate(zip(panels, ("m/s", "m/s", "rad/s"), strict=True)):
        for name in ("uncalibrated", "calibrated"):
            axes.plot(film["t"], film[name][k], color=_COLOURS[name], linewidth=1.1, label=name)
        axes.plot(film["t"], film["filmed"][k], color="black", linewidth=1.3, label="filmed")
        axes.set_ylabel(f"{found['measures'][k]} ({unit})")
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].legend(frameon=False, fontsize=8, ncols=3, loc="upper right")
    panels[-1].set_xlabel(f"time in clip {film['name']} (s)")
    figure_top = max(max(film["filmed"][0]), max(film["uncalibrated"][0]))
    panels[0].set_ylim(0, 1.35 * figure_top)
