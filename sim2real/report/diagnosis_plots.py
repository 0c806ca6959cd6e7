"""The figures of the diagnosis: residuals in time, residual torque over states, a command."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from sim2real.diagnose.result import Array, Experiment, JointSeries
from sim2real.report.quantity import printable
from sim2real.report.series import drawable
from sim2real.report.style import ACCENT, FAINT, INK, RULE, house_style, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

POINTS = 1500
"""Most points of a line, and of a cloud."""
AXES = {
    "position": "position, rad",
    "speed": "speed, rad/s",
    "error": "command − position, rad",
    "time": "time, s",
}
"""States that residual torque can be drawn against."""
_BINS, _VISITS = 16, 3
_INSIDE = 99.5


def residual_figure(
    evidence: Sequence[JointSeries],
    noise_rad: float,
    windows_s: Mapping[str, tuple[tuple[float, float], ...]],
    *,
    enriched: bool,
) -> Figure:
    """Draw what the plain servo leaves, and the enriched one, over time: a strip a recording."""
    with house_style():
        label = printable(f"{evidence[0].joint}: measured minus simulated, over time")
        figure = new_figure(58 + 104 * len(evidence), label)
        strips = figure.subplots(len(evidence), 1, sharey=True, squeeze=False)[:, 0]
        for axes, one in zip(strips, evidence, strict=True):
            for start, stop in windows_s.get(one.recording, ()):
                axes.axvspan(start, stop, color=RULE, alpha=0.6, linewidth=0, zorder=0)
            _noise(axes, 2e3 * noise_rad)
            _line(axes, one.t, 1e3 * (one.position - one.baseline), INK, "plain servo")
            if enriched:
                left = 1e3 * (one.position - one.enriched)
                _line(axes, one.t, left, ACCENT, "with the findings")
            axes.set_title(printable(f"{one.recording}, mrad"))
        strips[-1].set_xlabel("time, s")
        handles, labels = strips[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper left", ncols=2)
    return figure


def torque_figure(evidence: Sequence[JointSeries], unit: str) -> Figure:
    """Draw the torque that the plain servo lacks, against speed and against position."""
    speed, position = states(evidence, "speed"), states(evidence, "position")
    torque, sd = _joined(evidence, "torque"), _joined(evidence, "torque_sd")
    kept = np.flatnonzero(np.isfinite(speed) & np.isfinite(position) & np.isfinite(torque))
    kept = kept[np.linspace(0, kept.size - 1, min(kept.size, POINTS)).astype(np.intp)]
    with house_style():
        figure = new_figure(270, printable(f"{evidence[0].joint}: missing torque over state"))
        panels = figure.subplots(1, 2, sharey=True)
        for axes, name, x in zip(panels, ("speed", "position"), (speed, position), strict=True):
            _band(axes, sd)
            for up, colour in ((True, INK), (False, ACCENT)):
                some = kept[(speed[kept] >= 0) == up]
                look = {"markersize": 3, "markeredgewidth": 0, "alpha": 0.35, "color": colour}
                label = "turning up" if up else "turning down"
                axes.plot(x[some], torque[some], "o", label=label, **look)
            axes.set_xlabel(AXES[name])
            axes.locator_params(axis="x", nbins=3)
        panels[0].set_title(unit)
        if kept.size:
            reach = 1.3 * float(np.percentile(np.abs(torque[kept]), _INSIDE)) or 1.0
            panels[0].set_ylim(-reach, reach)
        handles, labels = panels[0].get_legend_handles_labels()
        shown = figure.legend(handles, labels, loc="outside upper left", ncols=2, markerscale=2)
        for handle in filter(None, shown.legend_handles):
            handle.set_alpha(1.0)
    return figure


def mean_figure(evidence: Sequence[JointSeries], state: str, unit: str) -> Figure:
    """Draw the mean of the missing torque in bins of a state, with two standard errors."""
    x, torque = states(evidence, state), _joined(evidence, "torque")
    time = np.concatenate([one.t + 1e6 * k for k, one in enumerate(evidence)])
    known = np.isfinite(x) & np.isfinite(torque) & np.isfinite(_joined(evidence, "position"))
    centres, means, errors = binned(x[known], torque[known], time[known])
    with house_style():
        figure = new_figure(230, printable(f"{evidence[0].joint}: mean missing torque"))
        axes = figure.subplots()
        _band(axes, _joined(evidence, "torque_sd"))
        axes.axhline(0, color=FAINT, linewidth=0.8)
        look: Any = {"fmt": "o", "markersize": 5, "markeredgewidth": 0, "linewidth": 1.2}
        axes.errorbar(centres, means, yerr=2 * errors, color=ACCENT, ecolor=INK, **look)
        axes.margins(x=0.04)
        axes.set_title(unit)
        axes.set_xlabel(AXES[state])
    return figure


def binned(x: Array, y: Array, t: Array) -> tuple[Array, Array, Array]:
    """Mean of ``y`` in bins of ``x`` and its standard error; bins rarely visited are left out.

    Neighbouring samples are not independent, so what falls into one segment of the smoothing's
    length counts once.
    """
    if not x.size:
        return x, y, x
    from sim2real.servo.linearised import WINDOW_S  # it loads scipy.signal

    low, high = np.percentile(x, [0.5, _INSIDE])
    edges = np.linspace(low, high, _BINS + 1)
    found = []
    for left, right in zip(edges[:-1], edges[1:], strict=True):
        inside = (x >= left) & (x < right)
        _, visit = np.unique(np.floor(t[inside] / WINDOW_S), return_inverse=True)
        counts = np.bincount(visit)
        if counts.size >= _VISITS:
            means = np.bincount(visit, y[inside]) / counts
            error = float(np.std(means, ddof=1) / np.sqrt(means.size))
            found.append((0.5 * (left + right), float(means.mean()), error))
    columns = np.array(found).reshape(-1, 3).T
    return columns[0], columns[1], columns[2]


def states(evidence: Sequence[JointSeries], name: str) -> Array:
    """Values of a state in all recordings, one after the other."""
    if name == "error":
        return _joined(evidence, "command") - _joined(evidence, "position")
    return _joined(evidence, {"time": "t"}.get(name, name))


def command_figure(experiment: Experiment) -> Figure:
    """Draw the command of the next experiment."""
    assert experiment.t is not None and experiment.signal is not None
    with house_style():
        figure = new_figure(170, "command of the next experiment")
        axes = figure.subplots()
        _line(axes, experiment.t, experiment.signal, INK, "command", drawstyle="steps-post")
        axes.set_title("command, rad")
        axes.set_xlabel("time, s")
    return figure


def outline(t: Array, values: Array) -> tuple[Array, Array]:
    """A line of at most ``POINTS`` points that keeps gaps, and extremes of what it leaves out."""
    t, values = drawable(t, values)
    if t.size <= POINTS:
        return t, values
    kept = []
    for part in np.array_split(np.arange(t.size), POINTS // 3):
        missing = np.isnan(values[part])
        low, high = (np.where(missing, sign * np.inf, values[part]) for sign in (1, -1))
        kept += [part[missing.argmax()], part[low.argmin()], part[high.argmax()]]
    chosen = np.unique(kept)
    return t[chosen], values[chosen]


def _line(axes: Axes, t: Array, values: Array, colour: str, label: str, **look: str) -> None:
    looks: Any = look
    axes.plot(*outline(t, values), color=colour, linewidth=0.9, label=label, **looks)


def _noise(axes: Axes, reach: float) -> None:
    """A band, and its edges in front of what is drawn: dense lines would hide it."""
    axes.axhspan(-reach, reach, color=ACCENT, alpha=0.16, linewidth=0)
    for edge in (-reach, reach):
        axes.axhline(edge, color=INK, linewidth=0.9, linestyle=(0, (5, 4)), zorder=4)


def _joined(evidence: Sequence[JointSeries], name: str) -> Array:
    return np.concatenate([getattr(one, name) for one in evidence])


def _band(axes: Axes, sd: Array) -> None:
    if np.isfinite(sd).any():
        width = 2 * float(np.nanmedian(sd))
        axes.axhspan(-width, width, color=RULE, alpha=0.6, linewidth=0, zorder=0)
