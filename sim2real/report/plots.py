"""The figures of the report. Matplotlib is loaded when one is drawn, not before."""

from sim2real.report.drawing import save_png, svg
from sim2real.report.fit_plot import fit_figure
from sim2real.report.parameter_plot import parameter_figure
from sim2real.report.style import NARROW, WIDE
from sim2real.report.timing_plot import timing_figure

__all__ = [
    "NARROW",
    "WIDE",
    "fit_figure",
    "parameter_figure",
    "save_png",
    "svg",
    "timing_figure",
]
