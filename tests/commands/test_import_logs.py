import json
from unittest.mock import MagicMock

import pytest
from good_input import refused

import sim2real as s2r
from sim2real.cli import main
from sim2real.importers import read_log
from sim2real.recording import Load, read_recording


def imported(source, out, *more):
    """The exit status of an import."""
    return main(["import", str(source), "--out", str(out), *more])


@pytest.fixture
def log(tmp_path):
    def entry(k):
        sample = {"position": 0.5, "goal_position": 0.0, "torque_enable": k not in (5, 6)}
        return sample | {"timestamp": 0.01 * k}

    file = tmp_path / "log.json"
    about = {"mass": 1, "length": 0.1, "gear_ratio": 2}
    file.write_text(json.dumps(about | {"entries": [entry(k) for k in range(9)]}))
    return file


def test_writes_a_recording_and_says_so(log, tmp_path, capsys):
    out = tmp_path / "new" / "out.csv"
    assert imported(log, out) == 0
    assert read_recording(out).t.size == 7
    line, unread, warning = capsys.readouterr().out.splitlines()
    assert unread == "! Unknown fields of the log are not read: gear_ratio."
    assert warning == "! warning: j1 starts 0.5 rad away from its first command."
    assert line == (
        f"{out}: 7 rows in 0.06 s; joints j1; 100 samples a second; load known on j1; "
        "2 rows omitted from 0.07 s: the torque comes on again"
    )


def test_the_sidecar_does_not_overwrite_the_log(log, capsys):
    before = log.read_text()
    refused(capsys, imported(log, log.with_suffix(".csv")), "which the command reads")
    assert log.read_text() == before


def test_bags_go_to_the_reader_of_bags(tmp_path, monkeypatch, log, capsys):
    read_bag = MagicMock(return_value=read_log.read_bam(log))
    monkeypatch.setattr(read_log, "read_bag", read_bag)
    bags = [tmp_path / name for name in ("a.bag", "a.db3", "a.mcap")]
    for source in (*bags, tmp_path):
        source.is_dir() or source.touch()
        options = ["--command-topic", "/c", "--joints", "j1"]
        assert imported(source, tmp_path / "out.csv", *options) == 0
        named = {"state_topic": "/joint_states", "command_topic": ["/c"], "joints": ["j1"]}
        read_bag.assert_called_with(source, **named)


@pytest.mark.parametrize(
    ("source", "out", "line"),
    [
        ("log.json", "out.json", "found the ending '.json', expected a file name ending in .csv"),
        ("nowhere.bag", "out.csv", "nowhere.bag: found no such file"),
        ("log.txt", "out.csv", "log.txt: found the ending '.txt'"),
        (".", "out.csv", "found no --command-topic"),
    ],
)
def test_errors_say_where_in_one_line(log, tmp_path, capsys, source, out, line):
    (tmp_path / "log.txt").touch()
    refused(capsys, imported(tmp_path / source, tmp_path / out), line)
    assert not (tmp_path / "out.csv").exists()


LOG = "time_ms,goal,present\n0,2048,2048\n10,2148,2049\n20,2148,2060\n"
COMPLETE = {
    "--columns": ["t=time_ms", "pan.command=goal", "pan.position=present"],
    "--time-unit": ["ms"],
    "--units": ["counts"],
    "--counts-per-turn": ["4096"],
    "--zero-count": ["2048"],
}


def table(tmp_path, *more, without=()):
    """The exit status of an import of a table with all options but some."""
    (tmp_path / "log.csv").write_text(LOG)
    options = [x for name, x in COMPLETE.items() if name not in without for x in (name, *x)]
    return imported(tmp_path / "log.csv", tmp_path / "pan.csv", *options, *more)


@pytest.mark.parametrize(
    "without",
    [
        ("--time-unit",),
        ("--counts-per-turn", "--zero-count"),
        ("--columns", "--time-unit", "--units"),
        tuple(COMPLETE),
    ],
)
def test_all_missing_options_are_asked_for_in_one_line(tmp_path, capsys, without):
    line = refused(capsys, table(tmp_path, without=without), *without)
    assert not any(option in line for option in set(COMPLETE) - set(without))
    assert not (tmp_path / "pan.csv").exists()


def test_without_loads_the_last_line_says_what_identify_will_do(tmp_path, capsys):
    assert table(tmp_path) == 0
    last = capsys.readouterr().out.splitlines()[-1]
    for part in ("load unknown of pan", "per unit of inertia", "--inertia pan=KGM2", "--pendulum"):
        assert part in last


@pytest.mark.parametrize(
    ("options", "load"),
    [
        (["--inertia", "pan=0.0021"], Load(0.0021)),
        (["--pendulum", "pan=0.1,0.2"], Load(0.1 * 0.2**2, 0.1, 0.2)),
        (["--inertia", "pan=0.005", "--pendulum", "pan=0.1,0.2"], Load(0.005, 0.1, 0.2)),
    ],
)
def test_loads_are_stated(tmp_path, capsys, options, load):
    assert table(tmp_path, *options) == 0
    assert read_recording(tmp_path / "pan.csv").loads == {"pan": load}
    named = {"columns": COMPLETE["--columns"], "time_unit": "ms", "units": "counts"}
    named |= {"counts_per_turn": 4096, "zero_count": 2048}
    named |= {options[k].removeprefix("--"): options[k + 1 : k + 2] for k in (0, len(options) - 2)}
    same = tmp_path / "same.csv"
    assert s2r.import_log(tmp_path / "log.csv", same, **named).loads == {"pan": load}
    assert same.read_text() == (tmp_path / "pan.csv").read_text()
    (line,) = capsys.readouterr().out.splitlines()
    assert "load known on pan" in line


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        (["--inertia", "tilt=0.1"], ("'tilt=0.1'", "pan")),
        (["--inertia", "0.1"], ("'0.1'", "J=KGM2")),
        (["--inertia", "pan=-1"], ("'pan=-1'", "above 0")),
        (["--inertia", "pan=0.1", "pan=0.2"], ("'pan=0.2'", "once")),
        (["--pendulum", "pan=0.1"], ("'pan=0.1'", "J=MASS_KG,LENGTH_M")),
        (["--inertia", "pan=0.001", "--pendulum", "pan=0.1,0.2"], ("pendulum's 0.004",)),
    ],
)
def test_bad_loads(tmp_path, capsys, options, parts):
    refused(capsys, table(tmp_path, *options), *parts)
    assert not (tmp_path / "pan.csv").exists()


@pytest.mark.parametrize(
    ("source", "options", "parts"),
    [
        ("log.csv", ["--joints", "pan"], ("--joints for a table", "--columns, --time-unit")),
        ("log.csv", ["--state-topic", "/x", "--episode", "1"], ("--state-topic, --episode",)),
        ("log.csv", ["--calibration", "arm.json"], ("--calibration for angles in counts",)),
        ("log.json", ["--units", "deg"], ("--units for a BAM log", "--inertia, --pendulum")),
        ("bam.json", ["--joints", "pan"], ("--joints for BAM's parameters", "--inertia")),
        (".", ["--time-unit", "ms", "--units", "deg"], ("--units, --time-unit for a ROS bag",)),
        ("dataset", ["--columns", "t=t"], ("--columns for a LeRobot dataset", "--episode")),
    ],
)
def test_options_of_another_format_are_refused(log, tmp_path, capsys, source, options, parts):
    (tmp_path / "bam.json").write_text('{"kt": 1, "actuator": "mx64", "model": "m1"}')
    (tmp_path / "dataset" / "meta").mkdir(parents=True)
    (tmp_path / "dataset" / "meta" / "info.json").write_text("{}")
    if source == "log.csv":
        status = table(tmp_path, *options)
    else:
        status = imported(tmp_path / source, tmp_path / "pan.csv", *options)
    refused(capsys, status, *parts)
    assert not (tmp_path / "pan.csv").exists()


@pytest.mark.parametrize("unit", ["deg", "rad", "turns"])
def test_options_of_another_unit_are_refused(tmp_path, capsys, unit):
    status = table(tmp_path, "--units", unit, without=["--units"])
    refused(capsys, status, f"found --counts-per-turn, --zero-count for angles in {unit}")
    status = table(tmp_path, "--units", unit, without=["--units", "--counts-per-turn"])
    refused(capsys, status, f"found --zero-count for angles in {unit}")
    assert not (tmp_path / "pan.csv").exists()


def test_times_in_another_unit_are_refused(log, tmp_path, capsys):
    """As 0 samples a second they could not be of a servo."""
    slow = json.loads(log.read_text())
    for entry in slow["entries"]:
        entry["timestamp"] *= 1000
    log.write_text(json.dumps(slow))
    status = imported(log, tmp_path / "pan.csv")
    refused(capsys, status, "times: found samples 10 s apart")
    status = table(tmp_path, "--time-unit", "s", without=("--time-unit",))
    refused(capsys, status, "--time-unit s: found samples 10 s apart")
    assert not (tmp_path / "pan.csv").exists()
