import math
import re
import subprocess
import sys
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from sim2real.errors import InputError
from sim2real.model import JointModel, Model
from sim2real.recording import Recording
from sim2real.report.drawing import save_png, svg
from sim2real.report.fit_plot import fit_figure
from sim2real.report.parameter_plot import parameter_figure
from sim2real.report.series import drawable, gaps, isolated_samples, largest_move, segments
from sim2real.report.style import NARROW
from sim2real.report.timing_plot import timing_figure


def lines(axes):
    return {line.get_label(): line for line in axes.get_lines()}


@pytest.fixture(scope="module")
def fit(bench):
    return fit_figure(
        bench.recording, "j1", bench.predicted[:, 0], heldout=bench.heldout, noise_rad=0.0019
    )


def test_importing_the_report_loads_neither_matplotlib_nor_jinja():
    program = "import sys, sim2real.report; print({'matplotlib', 'jinja2'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout.strip() == "set()", done.stderr


@pytest.mark.parametrize("library", ["matplotlib", "jinja2"])
def test_a_missing_library_is_said_in_one_line(library, monkeypatch, bench, tmp_path):
    from sim2real.report.page import write_page

    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ModuleNotFoundError) as raised:
        timing_figure(bench.recording)
        write_page(tmp_path / "page.html", "", "", [], {})
    name = {"matplotlib": "Matplotlib", "jinja2": "Jinja"}[library]
    assert str(raised.value) == (
        f"plots and pages: found no {name}, expected it installed: pip install 'sim2real[report]' "
        "(in a clone: pip install -e '.[report]')"
    )


def test_drawing_changes_no_global_setting(bench):
    import matplotlib

    before = dict(matplotlib.rcParams)
    svg(timing_figure(bench.recording))
    assert dict(matplotlib.rcParams) == before


def test_fit_figure_shows_all_samples_and_keeps_gaps(bench, fit):
    whole, residual, close = fit.axes
    recorded = bench.recording.position[:, 0]
    drawn = lines(whole)["measured"].get_ydata()
    assert np.isfinite(drawn).sum() == np.isfinite(recorded).sum()
    # one more than the missing samples: the segment in which no row came
    assert np.isnan(drawn).sum() == np.isnan(recorded).sum() + 1
    left = residual.get_lines()[0].get_ydata()
    expected = 1e3 * (recorded - bench.predicted[:, 0])
    assert np.nanmax(np.abs(left)) == pytest.approx(np.nanmax(np.abs(expected)))
    start, stop = close.get_xlim()
    assert stop - start == pytest.approx(1.5, abs=0.1)


def test_command_is_drawn_as_steps(fit):
    assert lines(fit.axes[0])["command"].get_drawstyle() == "steps-post"


def test_heldout_segment_is_labelled(fit):
    assert "held out" in [text.get_text() for text in fit.axes[0].texts]


def test_fit_figure_without_noise_heldout_or_commands(bench):
    recording = bench.recording
    mute = replace(recording, command=np.full_like(recording.command, np.nan), kind="pool")
    assert "<svg" in svg(fit_figure(mute, "j2", bench.predicted[:, 1]))


def test_fit_figure_with_nothing_measured(bench):
    blind = replace(bench.recording, position=np.full_like(bench.recording.position, np.nan))
    assert "<svg" in svg(fit_figure(blind, "j1", bench.predicted[:, 0], noise_rad=0.001))


def test_fit_figure_of_two_samples():
    two = np.array([[0.0], [0.1]])
    recording = Recording("two", "servo", ("j1",), np.array([0.0, 0.02]), two, two)
    assert "<svg" in svg(fit_figure(recording, "j1", two[:, 0], heldout=np.array([False, True])))
    assert "<svg" in svg(timing_figure(recording))


def test_fit_figure_refuses_what_does_not_belong(bench):
    with pytest.raises(ValueError, match="no joint 'tail'"):
        fit_figure(bench.recording, "tail", bench.predicted[:, 0])
    with pytest.raises(ValueError, match="predicted: shape"):
        fit_figure(bench.recording, "j1", bench.predicted)


def test_parameter_figure_has_a_panel_a_parameter_and_arrows_at_infinity(bench):
    panels = parameter_figure(bench.model).axes
    assert [axes.get_title(loc="left").split(",")[0] for axes in panels] == ["kp", "kd", "latency"]
    arrows = [line.get_marker() for line in panels[0].get_lines() if line.get_marker() in "<>"]
    assert arrows == [">"]
    assert all(np.isfinite(axes.get_xlim()).all() for axes in panels)


def test_parameter_figure_shows_one_unit_a_panel():
    known = JointModel(2.0, 0.06, 0.07, 0.002, interval={"kp_Nm_per_rad": (1.8, 2.2)})
    unknown = JointModel(1100.0, 30.0, 0.07, 1.0, per_inertia=True)
    panel = parameter_figure(Model({"a": known, "b": unknown})).axes[0]
    assert "1/s²" in panel.get_title(loc="left")
    dots = [line.get_xdata()[0] for line in panel.get_lines() if line.get_marker() == "o"]
    assert dots == pytest.approx([1000.0, 1100.0])


@pytest.mark.parametrize("model", [Model({}), Model({"j": JointModel(0.0, 0.0, 0.0, 1.0)})])
def test_parameter_figure_of_degenerate_models(model):
    assert "<svg" in svg(parameter_figure(model))


def test_parameter_figure_with_no_finite_end():
    ends = dict.fromkeys(("kp_Nm_per_rad", "kd_Nms_per_rad"), (-math.inf, math.inf))
    assert "<svg" in svg(parameter_figure(Model({"j": JointModel(1, 1, 0.1, 1, interval=ends)})))


def test_timing_figure_tells_jitter_from_gaps(bench):
    over_time, counts = timing_figure(bench.recording).axes
    drawn = over_time.get_lines()[0].get_ydata()
    assert np.isfinite(drawn).sum() == bench.recording.t.size - 2 and np.nanmax(drawn) < 30
    assert re.search(r"1 gap of 3\d\d ms", over_time.get_title(loc="left"))
    assert counts.patches


def test_timing_figure_of_a_long_recording_stays_small():
    t = np.cumsum(np.random.default_rng(0).uniform(0.009, 0.011, 100_000))
    rest = np.zeros((t.size, 1))
    assert len(svg(timing_figure(Recording("long", "servo", ("j1",), t, rest, rest)))) < 400_000


def test_svg_scales_and_stands_alone(fit):
    text = svg(fit)
    root = ElementTree.fromstring(text)
    assert "width" not in root.attrib and "height" not in root.attrib
    assert root.attrib["font-family"] == "sans-serif"
    assert {"<style", "<script", "<!", "xlink"}.isdisjoint(re.findall(r"<\w+|<!|xlink", text))
    assert all(link.startswith("#f") for link in re.findall(r'href="([^"]*)"', text))
    assert "predicted" in "".join(root.itertext())
    assert len(text) < 150_000


def test_svg_ids_are_unique_over_figures_and_widths(bench, fit):
    every = [svg(fit), svg(fit, width=NARROW), svg(parameter_figure(bench.model))]
    ids = [name for text in every for name in re.findall(r'\bid="([^"]*)"', text)]
    assert ids and len(ids) == len(set(ids))
    for text in every:
        assert set(re.findall(r"#(f[\w]+-\d+)", text)) == set(re.findall(r'\bid="([^"]*)"', text))


def test_svg_uses_the_colours_of_the_page(fit):
    bare = re.sub(r"var\(--\w+, #\w+\)", "", svg(fit))
    assert not re.search(r"(fill|stroke): #", bare)


def test_svg_is_deterministic_and_leaves_the_figure_as_it_was(bench, fit):
    again = fit_figure(
        bench.recording, "j1", bench.predicted[:, 0], heldout=bench.heldout, noise_rad=0.0019
    )
    first, narrow = svg(fit), svg(fit, width=NARROW)
    assert first == svg(fit) == svg(again) and narrow != first


def test_hostile_names_are_text(bench):
    name = '<script>alert("$x_1$")</script>\x00'
    recording = replace(bench.recording, joints=(name, "j2", "j3"), name="</svg>")
    text = svg(fit_figure(recording, name, bench.predicted[:, 0]))
    assert "<script" not in text and text.count("</svg>") == 1
    model = Model({"$x_1$": bench.model.joints["j1"]})
    assert "$x_1$" in svg(parameter_figure(model))


def test_png_is_written_whole(bench, tmp_path):
    path = save_png(timing_figure(bench.recording), tmp_path / "new" / "timing.png")
    assert path.read_bytes().startswith(b"\x89PNG")
    assert [p.name for p in path.parent.iterdir()] == ["timing.png"]
    with pytest.raises(InputError):
        save_png(timing_figure(bench.recording), tmp_path)


def test_long_series_keep_their_extremes_and_gaps():
    rng = np.random.default_rng(0)
    t = np.arange(200_000) * 0.01
    values = rng.normal(size=t.size)
    values[50_000:50_900] = np.nan
    times, kept = drawable(t, values)
    assert kept.size < 6000 and (np.diff(times) > 0).all()
    assert np.nanmax(kept) == np.nanmax(values) and np.nanmin(kept) == np.nanmin(values)
    assert np.isnan(kept).any()


def test_series_helpers():
    t = np.array([0, 0.02, 0.04, 0.5, 0.52])
    assert gaps(t).tolist() == [3]
    nan = np.nan
    assert isolated_samples(np.array([1.0, nan, 1.0, 1.0, nan, 1.0])).tolist() == [
        True,
        *[False] * 4,
        True,
    ]
    assert segments(np.array([True, True, False, True])) == [(0, 1), (3, 3)]


def test_largest_move_is_found_where_it_was_measured():
    t = np.arange(0, 20, 0.02)
    command = np.where(t < 5, 0.0, np.where(t < 12, 1.0, 0.4))
    start, stop = largest_move(t, command, command)
    assert start < 5 < stop and stop - start == pytest.approx(1.5)
    lost = np.where((t > 4.5) & (t < 7), np.nan, command)
    start, stop = largest_move(t, command, lost)
    assert start < 12 < stop
    rows = np.isfinite(lost)
    start, stop = largest_move(t[rows], command[rows], command[rows])
    assert start < 12 < stop


def test_bars_without_a_finite_value_end_at_the_edge():
    from sim2real.report.diagnosis_bars import Bar, bar_figure

    bars = [Bar("noise", 1.0, "1.0 mrad"), Bar("diverged", float("inf"), "∞")]
    figure = bar_figure({"j1": bars}, "errors")
    (axes,) = figure.axes
    assert axes.get_xlim() == (0.0, 1.2)
    assert [patch.get_width() for patch in axes.patches] == [1.0, 1.0]
