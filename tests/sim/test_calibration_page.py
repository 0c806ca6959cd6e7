"""A held-out error that a calibration makes worse is explained by its own numbers."""

from types import SimpleNamespace

import numpy as np

from sim.view.swim_page import calibration_section, error_comment
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


def test_only_an_error_that_grows_is_commented_on(monkeypatch):
    monkeypatch.setattr("sim.view.swim_page.simulated", lambda s, m, _: simulator(m))
    swim = SimpleNamespace(t=T, signals=SIGNALS, name="p1")
    robot = SimpleNamespace(joints=[SimpleNamespace(name="j1")])
    section = calibration_section(swim, None, calibrated(), simulator, robot)
    (note,) = [block.text for block in section.blocks if isinstance(block, Note)]
    assert note.startswith("sway: the held-out error rises from 0.010 to 0.020 m/s")
    assert "-50 %" in note and "does not generalise" in note and "96 %" in note and "drift" in note
    (table,) = [block for block in section.blocks if isinstance(block, Table)]
    assert [row[4] for row in table.rows] == ["-60 %", "+104 %", "0 %", "0 %"]
    assert table.rows[1][1] == f"{np.sqrt(np.mean(SIGNALS[201:, 1] ** 2)):.3f}"


def test_the_comment_follows_the_numbers():
    sizes = {"size": 0.2, "offset": 0.003}
    traded = error_comment("j1", "rad", (0.047, 0.055), (0.084, 0.088), **sizes)
    assert "gave up some of this one" in traded and "varies with" in traded
    assert error_comment("j1", "rad", (0.050, 0.052), (0.084, 0.088), **sizes) == ""
