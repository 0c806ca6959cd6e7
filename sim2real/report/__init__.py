"""Tables for the terminal, figures and HTML pages.

Matplotlib and Jinja are imported only when a figure or page is made.
"""

from sim2real.report.diagnosis import diagnosis_section
from sim2real.report.drawing import save_png, svg
from sim2real.report.fit_plot import fit_figure
from sim2real.report.identification import identification_section
from sim2real.report.page import Figure, Note, Section, Table, Text, write_page
from sim2real.report.parameter_plot import parameter_figure
from sim2real.report.table import fit_report
from sim2real.report.timing_plot import timing_figure

__all__ = [
    "Figure",
    "Note",
    "Section",
    "Table",
    "Text",
    "diagnosis_section",
    "fit_figure",
    "fit_report",
    "identification_section",
    "parameter_figure",
    "save_png",
    "svg",
    "timing_figure",
    "write_page",
]
