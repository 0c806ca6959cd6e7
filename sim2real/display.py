"""How results show themselves: figures, tables and HTML are in ``sim2real.report``, loaded late."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any


def from_report(name: str) -> Callable[..., Any]:
    """A function of ``sim2real.report`` by name, as ``"table.fit_report"``.

    Results use it to print and draw themselves: they import no figure, and Matplotlib and Jinja are
    loaded when something is drawn.
    """
    module, _, function = name.rpartition(".")
    found: Callable[..., Any] = getattr(
        importlib.import_module(f"sim2real.report.{module}"), function
    )
    return found


class NotebookDisplay:
    """Base of results that Jupyter shows as tables; ``report.notebook`` has a section for each."""

    def _repr_html_(self) -> str | None:
        """HTML for IPython, or None (it then shows the text) where Jinja is not installed."""
        try:
            html: str = from_report("notebook.result_html")(self)
            return html
        except ModuleNotFoundError:
            return None
