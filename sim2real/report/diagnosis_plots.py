"""Figures of the diagnosis: residuals over time, missing torque against states, a command."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sim2real.arrays import Array
from sim2real.diagnose.result import Experiment, JointSeries
from sim2real.report.live_plot import Live, Panel, in_mrad
from sim2real.report.quantity import printable
from sim2real.report.series import drawable
from sim2real.report.style import ACCENT, FAINT, INK, RULE, house_style, new_figure
from sim2real.viewers.scenes import residual_group

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

POINTS = 1500
"""Maximum number of points of a line or a cloud."""
AXES = {
    "position": "position, rad",
    "speed": "speed, rad/s",
    "error": "command − position, rad",
    "time": "time, s",
}
"""States that missing torque can be plotted against."""
_BINS, _VISITS = 16, 3
_INSIDE = 99.5


def residual_figure(
    evidence: Sequence[JointSeries],
    noise_rad: float,
    windows_s: Mapping[str, tuple[tuple[float, float], ...]],
    *,
    enriched: bool,
) -> Figure:
    """Plot the residuals of plain and enriched servo over time, one strip per recording."""
    with house_style():
        label = printable(f"{evidence[0].joint}: measured minus simulated, over time")
        figure = new_figure(58 + 104 * len(evidence), label)
        strips = figure.subplots(len(evidence), 1, sharey=True, squeeze=False)[:, 0]
        for axes, series in zip(strips, evidence, strict=True):
            for start, stop in windows_s.get(series.recording, ()):
                axes.axvspan(start, stop, color=RULE, alpha=0.6, linewidth=0, zorder=0)
            _noise(axes, 2e3 * noise_rad)
            _line(axes, series.t, 1e3 * (series.position - series.baseline), INK, "plain servo")
            if enriched:
                residual = 1e3 * (series.position - series.enriched)
                _line(axes, series.t, residual, ACCENT, "with the findings")
            axes.set_title(printable(f"{series.recording}, mrad"))
        strips[-1].set_xlabel("time, s")
        handles, labels = strips[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper left", ncols=2)
    return figure


def residual_live(
    evidence: Sequence[JointSeries],
    noise_rad: float,
    windows_s: Mapping[str, tuple[tuple[float, float], ...]],
    *,
    enriched: bool,
) -> Live:
    """The content of ``residual_figure`` to zoom into; arguments as there."""
    panels = []
    for series in evidence:
        residual = residual_group(series)
        kept = residual.signals if enriched else {"plain": residual.signals["plain"]}
        group = in_mrad(replace(residual, signals=kept))
        shaded = windows_s.get(series.recording, ())
        panels.append(Panel(group, f"{series.recording}, mrad", shaded, 2e3 * noise_rad))
    models = "the plain servo and the enriched model" if enriched else "the plain servo"
    return Live(
        panels,
        f"{evidence[0].joint}: measured minus simulated angle of {models}. Band: ±\u00a02 standard "
        "deviations of the noise; shaded: times with large residuals.",
    )


def torque_figure(evidence: Sequence[JointSeries], unit: str) -> Figure:
    """Plot the torque missing from the plain servo against speed and position."""
    speed, position = states(evidence, "speed"), states(evidence, "position")
    torque, sd = _joined(evidence, "torque"), _joined(evidence, "torque_sd")
    drawn = np.flatnonzero(np.isfinite(speed) & np.isfinite(position) & np.isfinite(torque))
    drawn = drawn[np.linspace(0, drawn.size - 1, min(drawn.size, POINTS)).astype(np.intp)]
    with house_style():
        figure = new_figure(270, printable(f"{evidence[0].joint}: missing torque over state"))
        panels = figure.subplots(1, 2, sharey=True)
        for axes, name, x in zip(panels, ("speed", "position"), (speed, position), strict=True):
            _band(axes, sd)
            for up, colour in ((True, INK), (False, ACCENT)):
                selected = drawn[(speed[drawn] >= 0) == up]
                look = {"markersize": 3, "markeredgewidth": 0, "alpha": 0.35, "color": colour}
                label = "turning up" if up else "turning down"
                axes.plot(x[selected], torque[selected], "o", label=label, **look)
            axes.set_xlabel(AXES[name])
            axes.locator_params(axis="x", nbins=3)
        panels[0].set_title(unit)
        if drawn.size:
            reach = 1.3 * float(np.percentile(np.abs(torque[drawn]), _INSIDE)) or 1.0
            panels[0].set_ylim(-reach, reach)
        handles, labels = panels[0].get_legend_handles_labels()
        shown = figure.legend(handles, labels, loc="outside upper left", ncols=2, markerscale=2)
        for handle in filter(None, shown.legend_handles):
            handle.set_alpha(1.0)
    return figure


def mean_figure(evidence: Sequence[JointSeries], state: str, unit: str) -> Figure:
    """Plot the mean of the missing torque in bins of a state, with two standard errors."""
    x, torque = states(evidence, state), _joined(evidence, "torque")
    time = np.concatenate([series.t + 1e6 * k for k, series in enumerate(evidence)])
    finite = np.isfinite(x) & np.isfinite(torque) & np.isfinite(_joined(evidence, "position"))
    centres, means, errors = binned(x[finite], torque[finite], time[finite])
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
    """Mean of ``y`` in bins of ``x`` and its standard error; bins with few visits are omitted.

    Neighbouring samples are correlated, so samples within one window of the smoothing count once.
    """
    if not x.size:
        return x, y, x
    from sim2real.servo.linearised import WINDOW_S  # it loads scipy.signal

    low, high = np.percentile(x, [0.5, _INSIDE])
    edges = np.linspace(low, high, _BINS + 1)
    bins = []
    for low_edge, high_edge in zip(edges[:-1], edges[1:], strict=True):
        in_bin = (x >= low_edge) & (x < high_edge)
        _, visit = np.unique(np.floor(t[in_bin] / WINDOW_S), return_inverse=True)
        counts = np.bincount(visit)
        if counts.size >= _VISITS:
            means = np.bincount(visit, y[in_bin]) / counts
            error = float(np.std(means, ddof=1) / np.sqrt(means.size))
            bins.append((0.5 * (low_edge + high_edge), float(means.mean()), error))
    columns = np.array(bins).reshape(-1, 3).T
    return columns[0], columns[1], columns[2]


def states(evidence: Sequence[JointSeries], name: str) -> Array:
    """Values of a state in all recordings, one after the other."""
    if name == "error":
        return _joined(evidence, "command") - _joined(evidence, "position")
    return _joined(evidence, {"time": "t"}.get(name, name))


def command_figure(experiment: Experiment) -> Figure:
    """Plot the command of the next experiment."""
    assert experiment.t is not None and experiment.signal is not None
    with house_style():
        figure = new_figure(170, "command of the next experiment")
        axes = figure.subplots()
        _line(axes, experiment.t, experiment.signal, INK, "command", drawstyle="steps-post")
        axes.set_title("command, rad")
        axes.set_xlabel("time, s")
    return figure


def outline(t: Array, values: Array) -> tuple[Array, Array]:
    """A line of at most ``POINTS`` points that keeps gaps and extremes."""
    t, values = drawable(t, values)
    if t.size <= POINTS:
        return t, values
    indices = []
    for part in np.array_split(np.arange(t.size), POINTS // 3):
        missing = np.isnan(values[part])
        low, high = (np.where(missing, sign * np.inf, values[part]) for sign in (1, -1))
        indices += [part[missing.argmax()], part[low.argmin()], part[high.argmax()]]
    chosen = np.unique(indices)
    return t[chosen], values[chosen]


def _line(axes: Axes, t: Array, values: Array, colour: str, label: str, **look: str) -> None:
    looks: Any = look
    axes.plot(*outline(t, values), color=colour, linewidth=0.9, label=label, **looks)


def _noise(axes: Axes, reach: float) -> None:
    """A band with its edges in front, as dense lines would hide it."""
    axes.axhspan(-reach, reach, color=ACCENT, alpha=0.16, linewidth=0)
    for edge in (-reach, reach):
        axes.axhline(edge, color=INK, linewidth=0.9, linestyle=(0, (5, 4)), zorder=4)


def _joined(evidence: Sequence[JointSeries], name: str) -> Array:
    return np.concatenate([getattr(series, name) for series in evidence])


def _band(axes: Axes, sd: Array) -> None:
    if np.isfinite(sd).any():
        width = 2 * float(np.nanmedian(sd))
        axes.axhspan(-width, width, color=RULE, alpha=0.6, linewidth=0, zorder=0)
