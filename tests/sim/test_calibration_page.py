"""A held-out error that a calibration makes worse is explained by its own numbers."""

from types import SimpleNamespace

import numpy as np
import pytest

from sim.view.calibration_page import SignalError, calibration_section, signal_errors
from sim2real.report.page import Note, Table

T = np.linspace(0, 30, 301)
SIGNALS = np.sin(T)[:, None] * np.array([0.3, 0.1, 1.0, 0.2])
OFFSET = np.array([0.0, 0.02, 0.0, 0.0])


def calibrated():
    """Surge gets better, sway drifts off in the held-out third, the rest stays as it was."""
    return SimpleNamespace(
        model=None,
        rmse=np.array([[0.05, 0.01, 0.2, 0.05], [0.02, 0.0204, 0.2, 0.05]]),
        train=np.array([[0.06, 0.02, 0.4, 0.08], [0.03, 0.01, 0.4, 0.08]]),
    )


def simulator(models, *_):
    return np.stack([SIGNALS + OFFSET] * len(models))


def errors(monkeypatch):
    monkeypatch.setattr("sim.view.calibration_page.simulated", lambda s, m, _: simulator(m))
    monkeypatch.setattr("sim.view.calibration_plot.simulated", lambda s, m, _: simulator(m))
    swim = SimpleNamespace(t=T, signals=SIGNALS, name="p1")
    return swim, SimpleNamespace(joints=[SimpleNamespace(name="j1")])


def test_offset_and_size_are_those_of_the_held_out_part(monkeypatch):
    swim, robot = errors(monkeypatch)
    surge, sway, *_ = signal_errors(swim, calibrated(), simulator, robot)
    assert sway.offset == pytest.approx(0.02) and surge.offset == pytest.approx(0.0)
    assert sway.size == pytest.approx(np.sqrt(np.mean(SIGNALS[201:, 1] ** 2)))
    assert (sway.held_out, sway.fitted) == ((0.01, 0.0204), (0.02, 0.01))


def test_only_an_error_that_grows_is_commented_on(monkeypatch):
    swim, robot = errors(monkeypatch)
    section = calibration_section(swim, None, calibrated(), simulator, robot)
    (note,) = [block.text for block in section.blocks if isinstance(block, Note)]
    assert note.startswith("sway: the held-out error rises from 0.010 to 0.020 m/s")
    assert "-50 %" in note and "does not generalise" in note and "96 %" in note and "drift" in note
    (table,) = [block for block in section.blocks if isinstance(block, Table)]
    assert [row[4] for row in table.rows] == ["-60 %", "+104 %", "0 %", "0 %"]


def test_the_comment_follows_the_numbers():
    traded = SignalError("j1", "rad", (0.047, 0.055), (0.084, 0.088), 0.2, 0.003)
    assert "gave up some of this one" in traded.comment and "varies with" in traded.comment
    assert SignalError("j1", "rad", (0.050, 0.052), (0.084, 0.088), 0.2, 0.003).comment == ""
