"""Time series as a figure, and as plots of a page that a reader can zoom into with uPlot."""

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import cycle
from typing import Any

import numpy as np

from sim2real.arrays import Array, Index, Mask
from sim2real.display import Drawing
from sim2real.inference.segments import runs
from sim2real.recording import Recording
from sim2real.report.drawing import (
    ACCENT,
    FAINT,
    INK,
    MUTED,
    RULE,
    VARIABLES,
    new_figure,
    svg,
)
from sim2real.report.page import Figure, printable
from sim2real.viewers.scenes import COMMAND, MEASURED, SignalGroup, fit_groups

GAP_INTERVALS = 3.0
LONGEST = 4000
_BINS = 1300
_COLOURS = {COMMAND: FAINT, MEASURED: INK, "plain": INK, "before": FAINT}
"""Colours of signals; of others the first is ``ACCENT``."""
_CLOSE_S, _LEAD_S = 1.5, 0.2


@dataclass(frozen=True)
class Panel:
    """One plot of a group of signals."""

    group: SignalGroup
    title: str  # with the unit
    shaded_s: Sequence[tuple[float, float]] = ()  # intervals of time
    band: float | None = None  # half-width of a band about 0
    log: bool = False  # whether the axis is logarithmic

    @property
    def curves(self) -> tuple[Array, list[tuple[str, str, Array]]]:
        """Times, and label, colour and values of each signal, long ones thinned."""
        signals, rest = self.group.signals, cycle((ACCENT, INK, MUTED, FAINT))
        t, values = drawable(self.group.t, np.stack(list(signals.values())))
        colours = [_COLOURS.get(name) or next(rest) for name in signals]
        return t, list(zip(signals, colours, values, strict=True))


def series_block(
    panels: Sequence[Panel], label: str, caption: str = "", *, close_up: Sequence[Panel] = ()
) -> Figure:
    """Panels of one recording as a block, zoomed together; ``close_up`` where nothing can be."""
    content = []
    for panel in panels:
        if not panel.group.signals:
            continue
        t, curves = panel.curves
        lines = [
            {"label": name, "ink": VARIABLES[ink], "steps": name == COMMAND, "y": _encoded(y)}
            for name, ink, y in curves
        ]
        shown = {"title": panel.title, "recording": panel.group.path[0], "t": _encoded(t)}
        shaded = [list(ends) for ends in panel.shaded_s]
        look = {"shaded": shaded, "band": panel.band, "log": panel.log}
        content.append({**shown, "curves": lines, **look})
    # A "<" would let a name end the element of the page.
    live = json.dumps(content, allow_nan=False).replace("<", "\\u003c")
    return Figure(svg(series_figure([*panels, *close_up], label)), caption, live)


def series_figure(panels: Sequence[Panel], label: str) -> Drawing:
    """Plot panels one below the other; lines are interrupted at gaps."""
    panels = [panel for panel in panels if panel.group.signals]
    with new_figure(30 + 150 * max(1, len(panels)), printable(label)) as figure:
        grid = figure.subplots(max(1, len(panels)), 1, squeeze=False)[:, 0]
        shown: list[str] = []
        for axes, panel in zip(grid, panels, strict=False):
            t, curves = panel.curves
            for start, stop in panel.shaded_s:
                axes.axvspan(start, stop, color=RULE, alpha=0.6, linewidth=0, zorder=0)
            if panel.band is not None:
                axes.axhspan(-panel.band, panel.band, color=ACCENT, alpha=0.16, linewidth=0)
            for name, colour, values in curves:
                look: dict[str, Any] = {"drawstyle": "steps-post"} if name == COMMAND else {}
                axes.plot(t, values, color=colour, lw=1.1, label=printable(name), **look)
                alone = isolated_samples(values)
                dots: dict[str, Any] = {"markersize": 1.6, "markeredgewidth": 0}
                axes.plot(t[alone], values[alone], "o", color=colour, **dots)
            axes.set_title(printable(panel.title))
            axes.set_yscale("log" if panel.log else "linear")
            if list(panel.group.signals) != shown and len(panel.group.signals) > 1:
                place = {"loc": "lower right", "bbox_to_anchor": (1, 1.02)}
                axes.legend(ncols=4, **(place if len(panel.group.signals) < 4 else {}))
            shown = list(panel.group.signals)
        grid[-1].set_xlabel("time, s")
    return figure


def fit_panels(
    recording: Recording,
    joint: str,
    predicted: Array,
    heldout: Mask | None = None,
    noise_rad: float | None = None,
) -> tuple[list[Panel], list[Panel]]:
    """Panels of a joint's prediction (T,) in rad, and a close-up of 1.5 s at the largest move."""
    position, *residual = fit_groups(recording, joint, predicted)
    t, shaded = recording.t, () if heldout is None else runs(heldout)
    spans = [(float(t[first]), float(t[after - 1])) for first, after in shaded]
    band = None if noise_rad is None else 2e3 * noise_rad
    title = "measured − predicted, mrad" + ("" if band is None else "; band: ± 2 × noise")
    panels = [Panel(position, "rad; shaded: held out for the error" if spans else "rad", spans)]
    panels += [Panel(in_mrad(group), title, spans, band) for group in residual]
    start = largest_move(t, position.signals)
    near = (t >= start) & (t <= start + _CLOSE_S)
    signals = {name: values[near] for name, values in position.signals.items()}
    close = replace(position, t=t[near], signals=signals)
    return panels, [Panel(close, "rad, the largest movement")]


def fit_figure(
    recording: Recording,
    joint: str,
    predicted: Array,
    heldout: Mask | None = None,
    noise_rad: float | None = None,
) -> Drawing:
    """Plot the prediction of one joint of a recording; arguments as for ``fit_panels``."""
    panels, close_up = fit_panels(recording, joint, predicted, heldout, noise_rad)
    return series_figure([*panels, *close_up], f"{joint} in {recording.name}")


def timing_panel(recording: Recording) -> Panel:
    """The time between samples."""
    interval = 1e3 * np.diff(recording.t)
    signals = {"time between samples": interval}
    group = SignalGroup((recording.name,), "ms", recording.t[1:], signals)
    low, median, high = np.percentile(interval, (5, 50, 95))
    title = f"ms between samples: {median:.1f}, nine in ten {low:.1f} to {high:.1f}"
    return Panel(group, f"{title}, longest {interval.max():.0f}")


def in_mrad(group: SignalGroup) -> SignalGroup:
    """Signals in rad, in mrad."""
    signals = {name: 1e3 * values for name, values in group.signals.items()}
    return replace(group, unit="mrad", signals=signals)


def gaps(t: Array) -> Index:
    """Indices of samples more than three median intervals after the previous one."""
    interval = np.diff(t)
    usual = np.median(interval) if interval.size else 0.0
    return np.flatnonzero(interval > GAP_INTERVALS * usual) + 1


def drawable(t: Array, values: Array) -> tuple[Array, Array]:
    """``values (K, T)`` over ``t (T,)``, thinned by smallest and largest, NaN in every gap."""
    starts = gaps(t)
    if starts.size:  # a sample is valid for one interval: a step line ends there
        t = np.insert(t, starts, t[starts - 1] + np.median(np.diff(t)))
    values = np.insert(values, starts, np.nan, axis=1)
    if t.size <= LONGEST:
        return t, values
    parts = np.array_split(np.arange(t.size), _BINS)
    kept: set[int] = set()
    for series in values:
        missing = np.isnan(series)
        low, high = (np.where(missing, sign * np.inf, series) for sign in (1, -1))
        for part in parts:
            kept.update(part[[missing[part].argmax(), low[part].argmin(), high[part].argmax()]])
    indices = np.array(sorted(kept))
    return t[indices], values[:, indices]


def isolated_samples(values: Array) -> Mask:
    """Mask of ``values`` between two missing ones, which a line would not show."""
    missing = np.concatenate([[True], np.isnan(values), [True]])
    isolated: Mask = ~missing[1:-1] & missing[:-2] & missing[2:]
    return isolated


def largest_move(t: Array, signals: Mapping[str, Array]) -> float:
    """Start of the largest movement within 0.2 s, of the command where a position was measured."""
    moving = next(iter(signals.values()))
    present = np.isfinite(signals.get(MEASURED, moving))
    ahead = np.searchsorted(t, t + _LEAD_S).clip(max=t.size - 1)
    move = np.nan_to_num(np.abs(moving[ahead] - moving)) * (present & present[ahead])
    move[t > max(t[0], t[-1] - _CLOSE_S)] = -1.0
    return float(t[np.argmax(move)])


def _encoded(values: Array) -> str:
    """Little-endian 32-bit floats in base64, with NaN where nothing is drawn."""
    return base64.b64encode(values.astype("<f4").tobytes()).decode()
