"""The library of servos: every entry is whole, models go anywhere, new entries are checked."""

import json
from pathlib import Path

import numpy as np
import pytest
from good_input import refused

import sim2real as s2r
from sim2real.cli import main
from sim2real.report.servo_table import markdown_row
from sim2real.servo.prediction import predict
from sim2real.servo_library.catalogue import FOLDER, at, entry_of

ABOUT = {
    "name": "mine_bench",
    "type": "Maker M1",
    "source": "own recordings",
    "licence": "CC0-1.0",
    "date": "2026-02-03",
    "supply_V": 7.4,
    "firmware_gain": 32,
}
OPTIONS = [
    "--as", "mine_bench", "--type", "Maker M1", "--source", "own recordings", "--licence",
    "CC0-1.0", "--date", "2026-02-03", "--supply", "7.4", "--firmware-gain", "32",
]  # fmt: skip


def refuses(capsys, line, *call):
    """A call of ``servos`` that writes one line, and no file in the current folder."""
    before = sorted(Path.cwd().iterdir())
    refused(capsys, main(["servos", *map(str, call)]), line)
    assert sorted(Path.cwd().iterdir()) == before


@pytest.fixture(scope="module")
def library():
    return s2r.servos()


@pytest.fixture
def identified(tmp_path, monkeypatch):
    """Writes a model file, with changes of its joint, as ``identify`` does; it lies here."""

    def write(without=(), **changes):
        gains = {"kp_Nm_per_rad": 2.0, "kd_Nms_per_rad": 0.05, "latency_s": 0.01}
        joint = {
            **gains,
            "inertia_kgm2": 0.002,
            "load": {"inertia_kgm2": 0.002, "pendulum_mass_kg": 0, "pendulum_length_m": 0},
            "interval": {name: [0.9 * value, 1.1 * value] for name, value in gains.items()},
            "correlation": {"kp_Nm_per_rad, kd_Nms_per_rad": 0.3},
        }
        provenance = {"command": "sim2real identify /home/me/steps.csv", "seed": 0}
        provenance |= {"inputs": {"/home/me/steps.csv": "abc"}, "held_out": {"pan": "chirp"}}
        content = {
            "schema": "sim2real.model/1",
            "joints": {"pan": {name: x for name, x in joint.items() if name not in without}},
            "fit": {"pan.position_rad": {"train": 0.002, "heldout": 0.0031}},
            "provenance": provenance,
        }
        (tmp_path / "model.json").write_text(json.dumps(content | changes))
        return tmp_path / "model.json"

    monkeypatch.chdir(tmp_path)
    return write


def test_every_entry_has_a_source_a_licence_and_a_sensible_motor(library):
    assert len(library) == len(list(FOLDER.glob("*.json"))) >= 10
    for gain in (200, 800):
        assert library[f"xl330_gain{gain}"].held_out_rad < library["xl330_bam_m5"].held_out_rad
    doubled = at(library["sts3250_kscale"], firmware_gain=16).model
    assert doubled.firmware_p_gain == 16 and library["sts3250_kscale"].model.firmware_p_gain == 8
    t = np.arange(0.0, 4.0, 0.01)
    step = {"hip": np.where(t < 0.5, 0.0, 0.2)}
    for entry in library:
        text = (FOLDER / f"{entry.name}.json").read_text()
        assert "/home" not in text and "../" not in text and "/work" not in text
        assert entry.source and entry.licence and entry.date
        if entry.origin == "identified":
            assert 0 < entry.held_out_rad < 0.1
            assert entry.joint.interval
        motor = entry.joint.motor
        if "no_load_speed_rad_s" in motor and not entry.joint.per_inertia:
            assert 1 < motor["no_load_speed_rad_s"] < 40
            assert 0.05 < motor["stall_torque_Nm"] < 30
        angle = predict(entry.for_joints("hip"), t, step)["hip"]
        assert np.isfinite(angle).all()
        assert 0.3 * 0.2 < angle[-1] < 1.2 * 0.2, entry.name  # below a weight, short of the goal


def test_servos_are_shown_as_a_table_as_plots_and_in_notebooks(library, capsys):
    assert main(["servos"]) == 0
    lines = {line.split()[0]: line for line in capsys.readouterr().out.splitlines() if line}
    assert all(e.type in lines[e.name] and e.date in lines[e.name] for e in library)
    assert "38.6 mrad" in lines["xl330_gain800"]
    left, right = library.plot().axes
    known = [entry for entry in library if not entry.joint.per_inertia]
    assert len(left.collections[0].get_offsets()) == len(known)
    assert [label.get_text() for label in left.get_yticklabels()] == [e.name for e in known]
    entry = library["xl330_gain800"]
    speed = entry.joint.motor["no_load_speed_rad_s"]
    assert entry.plot().axes[1].collections[0].get_offsets()[0][0] == pytest.approx(speed)
    html = library._repr_html_()
    assert html is not None and html.count("<tr") == len(library) + 1
    assert all(entry.date in html for entry in library)
    assert "Rhoban" in entry._repr_html_() and "stall torque" in entry._repr_html_()


def test_a_servo_of_a_robot_can_be_used_as_any_model(tmp_path):
    out = tmp_path / "model.json"
    assert main(["servos", "xl330_gain800", "--joints", "pan", "tilt", "--out", str(out)]) == 0
    model = s2r.read_model(out)
    assert model.fit.keys() == {"pan.position_rad", "tilt.position_rad"}
    t = np.linspace(0.0, 1.0, 50)
    assert list(predict(model, t, {"pan": 0 * t, "tilt": 0 * t})) == ["pan", "tilt"]


def test_half_the_gain_at_twice_the_supply_moves_the_same_below_saturation(library):
    entry = library["mx64_bam_m1"]
    other = at(entry, firmware_gain=16, supply_V=30)
    assert other.firmware_gain == 16 and other.supply_V == 30
    t = np.arange(0.0, 3.0, 0.005)
    command = {"j1": 0.15 * np.sin(4 * t)}
    same = predict(other.model, t, command)["j1"] - predict(entry.model, t, command)["j1"]
    assert np.abs(same).max() < 1e-6
    stiffer = predict(at(entry, firmware_gain=64).model, t, command)["j1"]
    assert np.abs(stiffer - predict(entry.model, t, command)["j1"]).max() > 0.005
    assert other.held_out_rad is None
    assert at(entry) is entry


def test_adding_an_entry(identified, tmp_path, capsys):
    out = tmp_path / "mine_bench.json"
    assert main(["servos", "add", str(identified()), *OPTIONS, "--out", str(out)]) == 0
    shown = capsys.readouterr().out
    assert "mine_bench" not in s2r.servos().names  # prepared, not shipped
    content = json.loads(out.read_text())
    more = {"origin": "identified", "scored_on": "chirp, which was not fitted"}
    assert content["provenance"]["servo"] == ABOUT | more
    assert content["provenance"]["inputs"] == {"steps.csv": "abc"}
    assert list(content["joints"]) == ["j1"]
    assert markdown_row(entry_of(s2r.read_model(out), out)) in shown
    assert "3.1 mrad" in shown


@pytest.mark.parametrize(
    ("changes", "options", "line"),
    [
        ({}, OPTIONS[2:], "provenance.servo.name: found nothing, expected text"),
        ({}, [*OPTIONS[:8], *OPTIONS[10:]], "provenance.servo.date: found nothing"),
        ({}, [*OPTIONS, "--date", "3 Feb"], "provenance.servo.date: found '3 Feb'"),
        ({}, OPTIONS[:-2], "provenance.servo.firmware_gain: found nothing"),
        ({"fit": {}}, OPTIONS, "fit.j1.position_rad.heldout: found nothing"),
        ({"without": ["load"]}, OPTIONS, "the load that it was identified with"),
        ({"without": ["interval"]}, OPTIONS, "90 %"),
        ({}, [*OPTIONS, "--as", "xl330_gain800"], "a name that is not in the library yet"),
        ({}, [*OPTIONS, "--as", "Mine 1"], "small letters, digits and underscores"),
        ({}, [*OPTIONS, "--joint", "tilt"], "joints: found tilt, expected --joint with one of pan"),
    ],
)
def test_a_model_that_lacks_something_is_refused_in_one_line(
    changes, options, line, identified, capsys
):
    refuses(capsys, line, "add", identified(**changes), *options)


@pytest.mark.parametrize(
    ("call", "line"),
    [
        (["xl330_gain80"], "did you mean xl330_gain800?"),
        (["--out", "m.json"], "expected the name of one"),
        (["add"], "MODEL: found nothing"),
        (["xl330_gain800", "--type", "x"], "--type: found xl330_gain800, expected servos add"),
        (["sts3215_stand", "--supply", "12"], "whose supply is not known"),
        (["sts3215_stand", "--firmware-gain", "16"], "whose firmware gain is not known"),
        (["mx64_bam_m1", "--supply=-1"], "expected a number above 0"),
    ],
)
def test_bad_calls_are_one_line(call, line, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    refuses(capsys, line, *call)
