"""Plots of a page that a reader can zoom into, drawn by uPlot where scripts run.

A page stays one file: the library and the data are inside it. Where scripts do not run, and on
paper, the page shows the SVG of the figure.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sim2real.arrays import Array
from sim2real.report.series import drawable_together
from sim2real.viewers.signal_group import COMMAND, MEASURED, SignalGroup

_FOLDER = Path(__file__).parent
_INKS = {COMMAND: "faint", MEASURED: "ink", "plain": "ink", "before": "faint"}
"""CSS variable with the colour of a signal; ``accent`` for all others."""

_HINT = (
    "Values are those at the cursor. Drag or pinch to zoom; double-click to see all of the time."
)


@dataclass(frozen=True)
class Panel:
    """One plot of a group of signals.

    Attributes:
        group: The signals.
        title: Title of the plot, with the unit.
        shaded_s: Intervals of time that are shaded.
        band: Half-width of a band about 0; None without a band.
    """

    group: SignalGroup
    title: str
    shaded_s: Sequence[tuple[float, float]] = ()
    band: float | None = None

    @property
    def content(self) -> dict[str, Any]:
        """What the script draws."""
        group = self.group
        t, values = drawable_together(group.t, np.stack(list(group.signals.values())))
        return {
            "title": self.title,
            "recording": group.path[0],
            "t": _encoded(t),
            "curves": [
                {
                    "label": name,
                    "ink": _INKS.get(name, "accent"),
                    "steps": name == COMMAND,
                    "y": _encoded(curve),
                }
                for name, curve in zip(group.signals, values, strict=True)
            ],
            "shaded": [list(ends) for ends in self.shaded_s],
            "band": self.band,
        }


@dataclass(frozen=True)
class Live:
    """Plots one below the other; those of one recording are zoomed together.

    Attributes:
        panels: The plots.
        text: What they show.
    """

    panels: Sequence[Panel]
    text: str

    @property
    def caption(self) -> str:
        """What they show, and how to zoom."""
        return f"{self.text} {_HINT}"

    @property
    def data(self) -> str:
        """What the script draws, as JSON that may stand in a page."""
        content = json.dumps([panel.content for panel in self.panels], allow_nan=False)
        return content.replace("<", "\\u003c")  # it would let a name end the element


def in_mrad(group: SignalGroup) -> SignalGroup:
    """Signals in rad, in mrad."""
    signals = {name: 1e3 * values for name, values in group.signals.items()}
    return replace(group, unit="mrad", signals=signals)


def live_style() -> str:
    """Style of the plots."""
    return "\n".join(_text(name) for name in ("uplot/uPlot.min.css", "live_plot.css"))


def live_script() -> str:
    """The script of a page with plots: uPlot, and what draws the plots with it."""
    return "\n".join(_text(name) for name in ("uplot/uPlot.iife.min.js", "live_plot.js"))


def script_hash(script: str) -> str:
    """A source for ``script-src`` of a content security policy, which allows this script alone."""
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    return f"'sha256-{digest}'"


def _encoded(values: Array) -> str:
    """Little-endian 32-bit floats in base64, with NaN where nothing is drawn."""
    return base64.b64encode(values.astype("<f4").tobytes()).decode()


def _text(name: str) -> str:
    return (_FOLDER / name).read_text(encoding="utf-8")
