"""Nothing that a page shows is cut: text lies inside its figure."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from rl.experiments.ablation_report import OUTCOME, return_figure
from rl.experiments.figures import aligned, bars_figure, paths_figure
from sim2real.report.diagnosis_plots import bar_figure
from sim2real.report.drawing import POINTS_PER_INCH, house_style, svg
from sim2real.report.identification import parameter_figure
from sim2real.report.ranges import density_figure, latency_figure

SLACK_POINTS = 1.0
LINKS = np.array([1.2, 1.1, 0.9, 0.6])
DENSITY = SimpleNamespace(
    links=("head", "body1", "body2", "tail"), length_m=np.full(4, 0.1), value=LINKS,
    interval=LINKS + 0.03 * np.array([[-1], [1]]),
)  # fmt: skip
SPREAD = SimpleNamespace(centre=0.07, half_width=0.02)
LATENCIES = SimpleNamespace(
    seconds=np.full(7, 0.07), sd=np.full(7, 0.01), windows=True, spread=SPREAD
)


def _returns():
    arms = [{"arm": arm} for arm in ("full", "no-servo", "no-density", "no-randomization")]
    for row in arms:
        bars = dict.fromkeys((OUTCOME, "paper"), (10.0, -3.0, 12.0))
        row |= dict.fromkeys(("simulation", "reality"), bars)
    return return_figure(arms)


def _bars():
    trials = {"time_s": np.array([50.0, 120.0]), "energy": np.array([60_000.0, 180_000.0])}
    return bars_figure({f"controller-{k}-of-a-long-name": trials for k in range(6)})


FIGURES = {
    "fit": lambda bench: bench.figure(),
    "parameters": lambda bench: parameter_figure(bench.model),
    "density": lambda bench: density_figure(DENSITY),
    "latency": lambda bench: latency_figure(LATENCIES),
    "bars": lambda bench: bar_figure([(0.98, "j1: one of backlash or play", True)]),
    "returns": lambda bench: _returns(),
    "controllers": lambda bench: _bars(),
}


def drawn(figure):
    """The box of a figure in points and that of all it shows."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    with house_style():
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        shown = figure.get_tightbbox(canvas.get_renderer())
    return POINTS_PER_INCH * shown.extents, POINTS_PER_INCH * figure.get_size_inches()


@pytest.mark.parametrize("name", FIGURES)
def test_nothing_sticks_out_of_a_figure(name, bench):
    (left, bottom, right, top), (wide, high) = drawn(FIGURES[name](bench))
    assert min(left, bottom) > -SLACK_POINTS
    assert right < wide + SLACK_POINTS and top < high + SLACK_POINTS


@pytest.mark.parametrize("make", [_returns, _bars])
def test_intervals_are_visible_on_dark_pages(make):
    """Every line has a colour of the page: a fixed grey or black vanishes on light or dark."""
    colours = re.findall(r"stroke: (#\w+)", svg(make()))
    assert not colours


def test_paths_are_all_in_view_where_no_limits_are_given():
    way = aligned(np.array([[0.0, 0.0], [1.0, 0.3], [3.0, 0.0]]), np.array([2.0, 0.0]))
    figure = paths_figure(dict.fromkeys("abc", [way]), "paths", away_m=[2.0])
    for axes in figure.axes[:3]:
        assert axes.get_xlim()[0] <= -3.0 and axes.get_ylim()[0] <= -0.3
    assert [axes.get_xlabel() for axes in figure.axes[:3]] == ["", "x (m)", "x (m)"]


def test_a_title_that_is_too_long_is_noticed():
    figure = density_figure(DENSITY)
    figure.axes[0].set_title("a title that a page has no room for, however it is laid out " * 3)
    (_, _, right, _), (wide, _) = drawn(figure)
    assert right > wide + SLACK_POINTS
