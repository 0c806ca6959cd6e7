"""Nothing that a page shows is cut: text lies inside its figure."""

from types import SimpleNamespace

import numpy as np
import pytest

from rl.experiments.ablation_report import OUTCOME, return_figure
from sim.view.calibration_plot import comparison
from sim2real.report.fit_plot import fit_figure
from sim2real.report.parameter_plot import parameter_figure
from sim2real.report.range_plots import density_figure, latency_figure, predictive_figure
from sim2real.report.style import NARROW, POINTS_PER_INCH, WIDE, house_style
from sim2real.report.timing_plot import timing_figure

SLACK_POINTS = 1.0
T = np.linspace(0, 30, 300)


def _fit(bench):
    return fit_figure(
        bench.recording, "j1", bench.predicted[:, 0], heldout=bench.heldout, noise_rad=0.0019
    )


def _density():
    links = ("head", "body1", "body2", "tail")
    value = np.array([1.2, 1.1, 0.9, 0.6])
    return SimpleNamespace(links=links, length_m=np.full(4, 0.1), value=value, sd=0.02 * value)


def _check():
    wave = 0.3 * np.sin(T)
    noise = np.random.default_rng(0).normal(0, 0.002, T.size)
    return SimpleNamespace(
        t=T, measured=wave + noise, median=wave, band=wave + 0.004 * np.array([[-1], [1]]),
        recording="chirp",
    )  # fmt: skip


def _comparison():
    names = [SimpleNamespace(name="j1")]
    swim = SimpleNamespace(t=T, signals=np.sin(T)[:, None] * np.ones(4), name="p1")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "sim.view.calibration_plot.simulated", lambda *_: np.zeros((2, *swim.signals.shape))
        )
        return comparison(swim, None, None, None, SimpleNamespace(joints=names))


def _returns():
    arms = [{"arm": arm} for arm in ("all", "no-servo", "no-density", "no-randomization")]
    for row in arms:
        row |= {testbed: {OUTCOME: (10.0, -3.0, 12.0)} for testbed in ("simulation", "reality")}
    return return_figure(arms)


FIGURES = {
    "fit": _fit,
    "parameters": lambda bench: parameter_figure(bench.model),
    "timing": lambda bench: timing_figure(bench.recording),
    "density": lambda bench: density_figure(_density()),
    "predictive": lambda bench: predictive_figure(_check(), "j1"),
    "latency": lambda bench: latency_figure(
        SimpleNamespace(seconds=np.full(7, 0.07), sd=np.full(7, 0.01), windows=True),
        SimpleNamespace(centre=0.07, half_width=0.02),
    ),
    "comparison": lambda bench: _comparison(),
    "returns": lambda bench: _returns(),
}


def drawn(figure, width):
    """``figure`` as it is drawn ``width`` points wide: its box and that of all it shows."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    with house_style():
        figure.set_size_inches(width / POINTS_PER_INCH, figure.get_size_inches()[1])
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        shown = figure.get_tightbbox(canvas.get_renderer())
    return POINTS_PER_INCH * shown.extents, POINTS_PER_INCH * figure.get_size_inches()


@pytest.mark.parametrize("width", [WIDE, NARROW])
@pytest.mark.parametrize("name", FIGURES)
def test_nothing_sticks_out_of_a_figure(name, width, bench):
    (left, bottom, right, top), (wide, high) = drawn(FIGURES[name](bench), width)
    assert min(left, bottom) > -SLACK_POINTS
    assert right < wide + SLACK_POINTS and top < high + SLACK_POINTS


def test_a_title_that_is_too_long_is_noticed():
    figure = density_figure(_density())
    figure.axes[0].set_title("a title that a phone has no room for, however it is laid out here")
    (_, _, right, _), (wide, _) = drawn(figure, NARROW)
    assert right > wide + SLACK_POINTS
