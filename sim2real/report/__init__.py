"""What a person looks at: the table on the terminal, the figures and the page.

Importing this package loads neither Matplotlib nor Jinja; a figure or a page does.
"""

from sim2real.report.diagnosis import diagnosis_section
from sim2real.report.identification import identification_section
from sim2real.report.page import Figure, Note, Section, Table, Text, write_page
from sim2real.report.plots import fit_figure, parameter_figure, save_png, svg, timing_figure
from sim2real.report.table import fit_report

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
