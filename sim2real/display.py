"""How results look in a notebook: as the tables of a report."""

from __future__ import annotations


class NotebookDisplay:
    """Base of results that Jupyter shows as tables; ``report.notebook`` has a section for each."""

    def _repr_html_(self) -> str | None:
        """HTML for IPython, or None (it then shows the text) where Jinja is not installed."""
        from sim2real.report.notebook import result_html

        try:
            return result_html(self)
        except ModuleNotFoundError:
            return None
