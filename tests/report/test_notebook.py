"""What a notebook and a prompt show of a result."""

import math
import re
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from markup import Markup

from sim.inference.calibration import Calibration
from sim.simulation import Simulated
from sim2real.check import check
from sim2real.diagnose.result import Diagnosis, Mismatch
from sim2real.model import FittedEffect, JointModel, Model
from sim2real.posterior.posteriors import Posteriors
from sim2real.ranges.entry import Ranges, normal, uniform
from sim2real.ranges.gather import Gathered
from sim2real.recording import Recording
from sim2real.report.notebook import result_html
from sim2real.report.page import WIDTH
from sim2real.report.quantity import Quantity, quantity_table
from sim2real.robot import Density, read_robot
from sim2real.servo.prediction import Prediction

EVIL = "<script>alert('&')</script>"


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
    return Calibration(Model({}), Model({}), robot, (), None, found)


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
        "joint": (replace(joint, notes=(EVIL,)), ["kp", "N m/rad", "2.25 to 2.75"]),
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


def test_a_notebook_shows_a_table_with_the_numbers_and_no_markup_of_files(results):
    for kind, (result, cells) in results.items():
        page = Markup(result._repr_html_())
        assert {"script", "html", "body"}.isdisjoint(page.tags), kind
        assert set(cells) <= set(page.cells), kind
        assert EVIL in page.text or kind == "simulated", kind


def test_the_text_has_the_cells_of_the_notebook(results):
    """But a diagnosis and what a swim says are written otherwise."""
    for kind, (result, cells) in results.items():
        text = str(result)
        assert max(map(len, text.splitlines())) <= 110, kind
        for cell in cells if kind not in ("model", "diagnosis", "simulated") else ():
            assert cell in text, kind


def test_errors_and_notes_of_a_fit_are_shown(results):
    model, _ = results["model"]
    fitted = replace(model, fit={"j1.position_rad": {"train": 0.0041, "heldout": None}})
    page = Markup(fitted._repr_html_())
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


def row(model, joint, name):
    """The words of the line of one parameter of one joint."""
    lines = (line.split() for line in str(model).splitlines())
    return next(words for words in lines if words[:2] == [joint, name])


def one_joint(**changes):
    joint = JointModel(2.0, 0.05, 0.06, 0.002)
    return Model({"j1": replace(joint, **changes)})


def test_what_the_recordings_do_not_bound_says_so():
    infinite = {
        "kp_Nm_per_rad": (1.5, 2.5),
        "kd_Nms_per_rad": (-math.inf, math.inf),
        "latency_s": (-math.inf, 0.07),
        "motor.rotor_inertia_kgm2": (0.0, math.inf),
        "motor.coulomb_Nm": (0.0, 0.05),
    }
    motor = {"rotor_inertia_kgm2": 0.002, "coulomb_Nm": 0.01}
    model = one_joint(interval=infinite, law="motor", motor=motor)
    assert row(model, "j1", "kp")[-3:] == ["±", "25", "%"]
    assert row(model, "j1", "Coulomb")[-3:] == ["±", "250", "%"]
    assert row(model, "j1", "kd")[-2:] == ["no", "bound"]
    assert row(model, "j1", "latency")[-2] == "below" and row(model, "j1", "rotor")[-2] == "above"
    assert "inf" not in str(model) and "nan" not in str(model)


def test_says_where_the_inertia_comes_from(bench):
    assert row(bench.model, "j1", "inertia")[-1] == "stated"
    model = one_joint(per_inertia=True, inertia_kgm2=1.0)
    assert row(model, "j1", "inertia")[-4:] == ["per", "unit", "of", "inertia"]
    assert "1/s²" in row(model, "j1", "kp") and "1/s" in row(model, "j1", "kd")


def test_errors_are_in_milliradians():
    figures = {"train": 0.002, "heldout": None, "heldout_without_effects": 0.03, "whiteness": 0.02}
    text = str(replace(one_joint(), fit={"j1.position_rad": figures}))
    assert " ".join(text.splitlines()[-1].split()) == (
        "j1 2.0 mrad - - white, plain PD: 30.0 mrad held out"
    )


def test_only_strong_correlations_strongest_first():
    correlation = {"a, b": 0.29, "kp_Nm_per_rad, latency_s": -0.4, "kp_Nm_per_rad, c": 0.9}
    text = str(one_joint(correlation=correlation))
    assert "j1: correlated kp and c +0.90, kp and latency -0.40" in text
    assert "a and b" not in text


def test_effects_of_joint_and_supply_are_listed_with_intervals():
    effects = (FittedEffect("backlash", {"gap_rad": 0.03}),)
    model = one_joint(effects=effects, interval={"backlash.gap_rad": (0.027, 0.033)})
    text = str(replace(model, effects=(FittedEffect("voltage_sag", {}),)))
    assert "j1: backlash (gap_rad 0.03, 0.027 to 0.033)" in text
    assert "supply and link: voltage_sag" in text


def test_notes_are_wrapped_and_marked_and_those_of_the_model_come_last(bench):
    lines = str(replace(bench.model, notes=("j2 is heavy",))).splitlines()
    first = next(k for k, line in enumerate(lines) if line.startswith("! j2: Every step"))
    assert lines[first + 1].startswith("  ") and "!" not in lines[first + 1]
    assert lines[-1] == "! j2 is heavy"


def test_no_line_is_wider_than_a_terminal_and_none_ends_in_space(bench):
    interval = {"kp_Nm_per_rad": (1e-9, 1e15), "kd_Nms_per_rad": (1.1e-7, 1.3e-7)}
    many = {"correlation": {f"a{k}, b{k}": 0.9 for k in range(30)}, "notes": ("word " * 80,)}
    hard = JointModel(1.23456789e12, 1.2e-7, 0.06, 2e-5, interval=interval, **many)
    for model in (bench.model, Model({"x" * 300: hard}), Model({})):
        for line in str(model).splitlines():
            assert len(line) <= WIDTH and line == line.rstrip()


def test_control_characters_do_not_reach_the_terminal():
    text = str(Model({"j\x1b[31m\n1": JointModel(1, 1, 0.1, 1, notes=("a\x07b",))}))
    assert "\x1b" not in text and "\x07" not in text


def test_a_table_says_the_probability_of_its_intervals():
    rows = [("j1", Quantity("kp", "N m/rad", 1.25, (1.0, 1.5)))]
    assert quantity_table(rows).header[4] == "90 % interval"
    assert quantity_table(rows, level=0.68).header[4] == "68 % interval"


def test_a_value_far_below_its_interval_has_the_digits_of_the_interval():
    friction = Quantity("load friction", "", 1e-9, (0.0, 0.66542), "")
    assert friction.texts == ("0.000", "0.000", "0.665")
    kp = Quantity("kp", "", 1.37424, (1.36861, 1.37983), "")
    assert kp.texts == ("1.3742", "1.3686", "1.3798")
