"""``export-servo`` and ``export-ranges``: what they print, and that nothing is half-written."""

import json

import pytest
from good_input import MODEL, ROBOT

from sim2real.cli import main


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "model.json"
    path.write_text(json.dumps(MODEL))
    return path


@pytest.mark.parametrize("target", ["mujoco", "isaaclab", "urdf", "json"])
def test_what_is_lacking_is_printed_and_written(model, target, capsys):
    out, robot = model.with_name("out.txt"), model.with_name("robot.toml")
    robot.write_text(ROBOT)
    call = ["export-servo", str(model), "--to", target, "--out", str(out), "--robot", str(robot)]
    # Without friction or inertia of the output MuJoCo's play is no better than a plain servo.
    assert main([*call, "--which", "effects"] if target == "mujoco" else call) == 0
    first, *listed = capsys.readouterr().out.splitlines()
    assert first == f"{out}: for {target}"
    text = out.read_text()
    if target == "json":
        assert not listed
        assert json.loads(text)["joints"]["j1"]["effects"][0]["effect"] == "backlash"
    elif target == "mujoco":  # has all of it
        assert not any("backlash" in line for line in listed)
        assert 'range="-0.015 0.015"' in text
    else:
        costs = [line for line in listed[1:] if not line.startswith("  ")]
        listed = [line for line in listed if line not in costs]
        assert costs[0].startswith("j1: refitted without backlash: ")
        assert any("backlash (gap_rad = 0.03)" in line for line in listed[1:])
        assert all(line.strip() in text for line in listed[1:])


def test_ranges(tmp_path, capsys):
    out = tmp_path / "ranges.py"
    call = ["export-ranges", "datasets/pool/ranges.json", "--to", "isaaclab", "--out", str(out)]
    assert main(call) == 0
    assert "position_noise_m" in capsys.readouterr().out
    assert "position_noise_m" in out.read_text()


def test_refused(model, capsys):
    def refused(*parts, command="servo", source=model, to="urdf"):
        call = [f"export-{command}", str(source), "--to", to, "--out", str(out)]
        assert main(call) == 2
        line = capsys.readouterr().err
        assert line.count("\n") == 1
        assert all(part in line for part in parts)

    out = model.parent
    refused("a folder")
    out = model.with_name("out.xml")
    refused("no such file", source="no.json")
    refused("schema", command="ranges", to="isaaclab")
    with pytest.raises(SystemExit) as stop:
        refused(to="gazebo")
    assert stop.value.code == 2
    assert not out.exists()
