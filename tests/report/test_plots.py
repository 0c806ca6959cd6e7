"""Figures: what they draw, and the SVG and PNG that are made of them."""

import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from sim2real.inference.segments import runs
from sim2real.model import JointModel, Model
from sim2real.recording import Recording
from sim2real.report.drawing import svg
from sim2real.report.identification import parameter_figure
from sim2real.report.series import (
    Panel,
    drawable,
    fit_figure,
    gaps,
    isolated_samples,
    largest_move,
    series_figure,
    timing_panel,
)
from sim2real.viewers.scenes import SignalGroup


def timing_figure(recording):
    return series_figure([timing_panel(recording)], "clock")


@pytest.fixture(scope="module")
def fit(bench):
    return bench.figure()


def test_drawing_changes_no_global_setting(bench):
    import matplotlib

    before = dict(matplotlib.rcParams)
    svg(timing_figure(bench.recording))
    assert dict(matplotlib.rcParams) == before


def test_fit_figure_shows_all_samples_and_keeps_gaps(bench, fit):
    whole, residual, close = fit.axes
    recorded = bench.recording.position[:, 0]
    lines = {line.get_label(): line for line in whole.get_lines()}
    drawn = lines["measured"].get_ydata()
    assert np.isfinite(drawn).sum() == np.isfinite(recorded).sum()
    # one more than the missing samples: the segment in which no row came
    assert np.isnan(drawn).sum() == np.isnan(recorded).sum() + 1
    assert lines["command"].get_drawstyle() == "steps-post"
    left = residual.get_lines()[0].get_ydata()
    expected = 1e3 * (recorded - bench.predicted[:, 0])
    assert np.nanmax(np.abs(left)) == pytest.approx(np.nanmax(np.abs(expected)))
    start, stop = close.get_xlim()
    assert stop - start == pytest.approx(1.5, abs=0.1)
    assert "held out" in whole.get_title(loc="left") and "noise" in residual.get_title(loc="left")


def test_fit_figure_of_little(bench):
    """Without noise, held-out samples or commands; with nothing measured; of two samples."""
    nothing = np.full_like(bench.recording.command, np.nan)
    mute = replace(bench.recording, command=nothing, kind="pool")
    assert "<svg" in svg(fit_figure(mute, "j2", bench.predicted[:, 1]))
    blind = replace(bench.recording, position=nothing)
    assert "<svg" in svg(fit_figure(blind, "j1", bench.predicted[:, 0], noise_rad=0.001))
    two = np.array([[0.0], [0.1]])
    recording = Recording("two", "servo", ("j1",), np.array([0.0, 0.02]), two, two)
    assert "<svg" in svg(fit_figure(recording, "j1", two[:, 0], heldout=np.array([False, True])))
    assert "<svg" in svg(timing_figure(recording))


def test_parameter_figure_has_a_panel_a_parameter(bench):
    panels = parameter_figure(bench.model).axes
    assert [axes.get_title(loc="left").split(",")[0] for axes in panels] == ["kp", "kd", "latency"]
    assert all(np.isfinite(axes.get_xlim()).all() for axes in panels)  # one end is infinite
    for model in (Model({}), Model({"j": JointModel(0.0, 0.0, 0.0, 1.0)})):
        assert "<svg" in svg(parameter_figure(model))


def test_timing_panel_tells_jitter_from_gaps(bench):
    panel = timing_panel(bench.recording)
    assert re.search(r"20.\d, nine in ten 1\d.\d to 2\d.\d, longest 3\d\d$", panel.title)
    (_, curves) = panel.curves
    assert np.nanmax(curves[0][2]) > 300


def test_a_figure_of_a_long_recording_stays_small():
    t = np.cumsum(np.random.default_rng(0).uniform(0.009, 0.011, 100_000))
    rest = np.zeros((t.size, 1))
    assert len(svg(timing_figure(Recording("long", "servo", ("j1",), t, rest, rest)))) < 400_000


def test_svg_scales_and_stands_alone(fit):
    text = svg(fit)
    root = ElementTree.fromstring(text)
    assert "width" not in root.attrib and "height" not in root.attrib
    assert {"<style", "<script", "<!", "xlink"}.isdisjoint(re.findall(r"<\w+|<!|xlink", text))
    assert all(link.startswith("#f") for link in re.findall(r'href="([^"]*)"', text))
    assert "predicted" in "".join(root.itertext()) and "DejaVu" not in text
    assert len(text) < 200_000


def test_svg_ids_are_unique_over_figures(bench, fit):
    every = [svg(fit), svg(parameter_figure(bench.model))]
    ids = [name for text in every for name in re.findall(r'\bid="([^"]*)"', text)]
    assert ids and len(ids) == len(set(ids))
    for text in every:
        assert set(re.findall(r"#(f[\w]+-\d+)", text)) == set(re.findall(r'\bid="([^"]*)"', text))


def test_svg_uses_the_colours_of_the_page(fit):
    bare = re.sub(r"var\(--\w+, #\w+\)", "", svg(fit))
    assert not re.search(r"(fill|stroke): #", bare)


def test_svg_is_deterministic_and_leaves_the_figure_as_it_was(bench, fit):
    assert svg(fit) == svg(fit) == svg(bench.figure())


def test_names_and_numbers_are_text():
    name = '<script>alert("$x_1$")</script>\x00 1.23456'
    signals = {name: np.arange(5.0), "b": np.ones(5)}
    panel = Panel(SignalGroup(("</svg>",), "rad", np.arange(5.0), signals), name)
    text = svg(series_figure([panel], name))
    assert "<script" not in text and text.count("</svg>") == 1
    assert "$x_1$" in text and "1.23456" in text
    ElementTree.fromstring(text)


def test_long_series_keep_their_extremes_and_gaps():
    rng = np.random.default_rng(0)
    t = np.arange(200_000) * 0.01
    values = rng.normal(size=(2, t.size))
    values[0, 50_000:50_900] = np.nan
    times, kept = drawable(t, values)
    assert times.size < 9000 and (np.diff(times) > 0).all()
    for all_values, drawn in zip(values, kept, strict=True):
        assert np.nanmax(drawn) == np.nanmax(all_values)
        assert np.nanmin(drawn) == np.nanmin(all_values)
    assert np.isnan(kept[0]).any()


def test_series_helpers():
    t = np.array([0, 0.02, 0.04, 0.5, 0.52])
    assert gaps(t).tolist() == [3]
    alone = isolated_samples(np.array([1.0, np.nan, 1.0, 1.0, np.nan, 1.0]))
    assert np.flatnonzero(alone).tolist() == [0, 5]
    assert runs(np.array([True, True, False, True])).tolist() == [[0, 2], [3, 4]]


def test_largest_move_is_found_where_it_was_measured():
    t = np.arange(0, 20, 0.02)
    command = np.where(t < 5, 0.0, np.where(t < 12, 1.0, 0.4))
    start = largest_move(t, {"command": command, "measured": command})
    assert start < 5 < start + 0.3
    lost = np.where((t > 4.5) & (t < 7), np.nan, command)
    start = largest_move(t, {"command": command, "measured": lost})
    assert start < 12 < start + 0.3
