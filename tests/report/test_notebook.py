"""What a notebook and a prompt show of a result."""

import re
import sys
from dataclasses import replace
from html.parser import HTMLParser
from types import SimpleNamespace

import numpy as np
import pytest

from sim.inference.calibration import Calibration
from sim.simulation import Simulated
from sim2real.check import check
from sim2real.diagnose.result import Diagnosis, Mismatch
from sim2real.model import JointModel, Model
from sim2real.posterior.posteriors import Posteriors
from sim2real.ranges.entry import Ranges, normal, uniform
from sim2real.ranges.gather import Gathered
from sim2real.recording import Recording
from sim2real.report.notebook import result_html
from sim2real.robot import Density, read_robot
from sim2real.servo.prediction import Prediction

EVIL = "<script>alert('&')</script>"
VOID = {"br", "wbr"}


class Fragment(HTMLParser):
    """The cells of a fragment; checks that its tags close in order."""

    def __init__(self, html):
        super().__init__()
        self.open, self.cells, self.text = [], [], ""
        self.feed(html)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attrs):
        assert tag not in ("script", "html", "body")
        if tag not in VOID:
            self.open.append(tag)
        if tag == "td":
            self.cells.append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data
        if "td" in self.open:
            self.cells[-1] += data


def robot_with(tmp_path, name):
    path = tmp_path / "robot.toml"
    path.write_text(
        f"name = {name!r}\n[servos.s]\n[[links]]\nname = 'head'\nmass_kg = 0.25\n"
        "[[links]]\nname = 'tail'\n"
        "[[joints]]\nname = 'j1'\nservo = 's'\nlimits_rad = [-1.5, 1.25]\n"
    )
    return read_robot(path)


def posterior_of(name):
    """A posterior with two parameters, whose quantiles are known."""
    each = [SimpleNamespace(name=n, unit=unit) for n, unit in ((name, "s"), ("kp", "N m/rad"))]
    servo = SimpleNamespace(
        parameters=each,
        level=0.9,
        shares=(0.05, 0.5, 0.95),
        quantiles=lambda *_: np.array([[0.01, 1.5], [0.02, 1.625], [0.03, 1.75]]),
    )
    return Posteriors({"j1": servo}, {})


def calibration_of(robot):
    found = SimpleNamespace(
        free=(SimpleNamespace(name=EVIL),),
        best=np.array([1.25]),
        centre=np.array([1.25]),
        covariance=np.eye(1),
        interval=lambda: np.array([[1.0, 1.5]]),
        rmse=np.array([[0.5, 0.5, 0.5, 0.5], [0.25, 0.25, 0.25, 0.125]]),
        noise=np.array([0.0, 0.0, 0.0, 0.1]),
    )
    return Calibration(Model({}), Model({}), robot, (), found)


@pytest.fixture
def recording():
    t = np.arange(500) * 0.02
    wave = 0.5 * np.sin(3 * t)
    command = np.stack([wave, 0 * t], axis=1)
    position = np.stack([0.5 * np.sin(3 * (t - 0.08)), 0 * t], axis=1)
    position[20:27, 1] = np.nan
    return Recording("steps", "servo", ("j1", EVIL), t, command, position)


@pytest.fixture
def results(recording, tmp_path):
    """One of each kind, with markup where a file can bring it in, and cells to be found."""
    robot = robot_with(tmp_path, EVIL)
    joint = JointModel(2.5, 0.0625, 0.066, 0.002, interval={"kp_Nm_per_rad": (2.25, 2.75)})
    model = Model({"j1": joint, EVIL: joint}, notes=(EVIL,))
    mismatch = Mismatch(f"{EVIL}.position_rad", EVIL, 0.005, 0.001, 0.9, {}, "always")
    none = {"rivals": (), "unknown": {}, "baseline_fit": {}, "enriched_fit": {}}
    diagnosis = Diagnosis("unexplained", (mismatch,), (), model=model, **none)
    ranges = Ranges((uniform("latency_s", 0.01, 0.03, "s", EVIL), normal(EVIL, 1, 0.5, "", "")))
    density = Density((EVIL, "tail"), np.array([0.75, 1.25]), None, np.ones(2), np.ones(2))
    swim = replace(recording, columns={n: recording.t for n in ("body.x_m", "body.y_m")})
    return {
        "model": (model, ["kp", "N m/rad", "2.25 to 2.75", EVIL]),
        "diagnosis": (diagnosis, []),
        "density": (density, [EVIL, "0.750", "1.250"]),
        "posterior": (posterior_of(EVIL), [EVIL, "0.0200", "0.0100 to 0.0300", "1.62"]),
        "ranges": (ranges, ["latency_s", "0.01 to 0.03 s", EVIL, "1 ± 0.5"]),
        "gathered": (Gathered(ranges), ["0.01 to 0.03 s", EVIL]),
        "prediction": (
            Prediction((recording,), (recording.command + 0.002,)),
            ["steps", EVIL, "2.0 mrad"],
        ),
        "calibration": (calibration_of(robot), [EVIL, "1.00 to 1.50", "0.5000", "0.1250", "rad"]),
        "simulated": (Simulated((swim,)), ["steps"]),
        "recording": (recording, ["-0.500 to 0.500 rad", EVIL, "7"]),
        "robot": (robot, ["0.25", "–", "-1.5 to 1.25"]),
        "check": (check(recording), [EVIL, "7"]),
    }


KINDS = (
    "model", "diagnosis", "density", "posterior", "ranges", "gathered", "prediction", "calibration",
    "simulated", "recording", "robot", "check",
)  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_a_notebook_shows_a_table_with_the_numbers_and_no_markup_of_files(kind, results):
    result, cells = results[kind]
    page = Fragment(result._repr_html_())
    for cell in cells:
        assert cell in page.cells, page.cells
    if kind != "simulated":
        assert EVIL in page.text


@pytest.mark.parametrize("kind", KINDS)
def test_the_text_has_the_cells_of_the_notebook(kind, results):
    """But a diagnosis and what a swim says are written otherwise."""
    result, cells = results[kind]
    text = str(result)
    assert max(map(len, text.splitlines())) <= 110
    for cell in cells if kind not in ("model", "diagnosis", "simulated") else ():
        assert cell in text


def test_errors_and_notes_of_a_fit_are_shown(results):
    model, _ = results["model"]
    fitted = replace(model, fit={"j1.position_rad": {"train": 0.0041, "heldout": None}})
    page = Fragment(fitted._repr_html_())
    assert page.cells[-4:] == ["4.1 mrad", "-", "-", ""]
    assert EVIL in page.text.split("RMSE")[-1]


def test_without_jinja_a_notebook_shows_the_text(results, monkeypatch):
    monkeypatch.setitem(sys.modules, "jinja2", None)
    for result, _ in results.values():
        assert result._repr_html_() is None


def test_another_kind_of_result_is_refused():
    with pytest.raises(TypeError, match="int"):
        result_html(3)


def test_a_bare_recording_is_one_line(recording):
    text = repr(recording)
    assert "\n" not in text
    assert len(text) < 200
    for part in ("steps", "servo", "9.98 s", "500 samples", "50 Hz", "7 positions missing", "j1"):
        assert part in text


def test_a_recording_prints_the_span_of_each_joint(recording):
    first, *_, j1, j2 = str(recording).splitlines()
    assert first == f"Recording steps: {recording.summary}"
    assert "-0.500 to 0.500 rad" in j1 and j1.endswith(" 0")
    assert "0.000 to 0.000 rad" in j2 and j2.endswith(" 7")
    blind = replace(recording, position=np.full_like(recording.position, np.nan))
    assert re.search(r"none +500$", str(blind))
