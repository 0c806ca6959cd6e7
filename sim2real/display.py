"""Display of results by functions of ``sim2real.report``, which are imported on demand."""

import importlib
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    Drawing = Figure
else:
    Drawing = Any  # Matplotlib is imported where a figure is drawn


def from_report(name: str) -> Callable[..., Any]:
    """A function of ``sim2real.report`` by name, as ``"notebook.result_text"``."""
    module, _, function = name.rpartition(".")
    home = importlib.import_module(f"sim2real.report.{module}")
    found: Callable[..., Any] = getattr(home, function)
    return found


class NotebookDisplay:
    """Base of results that are shown as tables, in Jupyter and as text, by ``report.notebook``."""

    def __str__(self) -> str:
        return str(from_report("notebook.result_text")(self))

    def _repr_html_(self) -> str | None:
        """HTML for IPython, or None (it then shows the text) where Jinja is not installed."""
        try:
            return str(from_report("notebook.result_html")(self))
        except ModuleNotFoundError:
            return None
