from __future__ import annotations

import argparse
import json

import pytest

from sim2real.commands import import_logs as command
from sim2real.errors import InputError
from sim2real.recording import read_recording


def arguments(source, out, **changes):
    defaults = {"state_topic": None, "command_topic": None, "joints": None}
    return argparse.Namespace(source=str(source), out=str(out), **(defaults | changes))


@pytest.fixture
def log(tmp_path):
    def entry(k):
        sample = {"position": 0.5, "goal_position": 0.0, "torque_enable": k not in (5, 6)}
        return sample | {"timestamp": 0.01 * k}

    file = tmp_path / "log.json"
    file.write_text(json.dumps({"mass": 1, "length": 0.1, "entries": [entry(k) for k in range(9)]}))
    return file


def test_writes_a_recording_and_says_so_in_one_line(log, tmp_path, capsys):
    out = tmp_path / "new" / "out.csv"
    assert command.run(arguments(log, out)) == 0
    assert read_recording(out).t.size == 7
    (line,) = capsys.readouterr().out.splitlines()
    assert line == (
        f"{out}: 7 rows in 0.06 s; joints j1; 100 samples a second; load known on j1; "
        "j1 starts +0.50 rad off its first command; "
        "2 rows left out from 0.07 s: the torque comes on again"
    )


def test_the_sidecar_does_not_overwrite_the_log(log):
    before = log.read_text()
    with pytest.raises(InputError, match="would overwrite the log"):
        command.run(arguments(log, log.with_suffix(".csv")))
    assert log.read_text() == before


def test_bags_go_to_the_reader_of_bags(tmp_path, monkeypatch, log, capsys):
    seen = {}

    def read_bag(source, **options):
        seen.update(options, source=source)
        return command.read_bam(log)

    monkeypatch.setattr(command, "read_bag", read_bag)
    for name in ("a.bag", "a.db3", "a.mcap"):
        (tmp_path / name).touch()
    for source in (tmp_path, *(tmp_path / name for name in ("a.bag", "a.db3", "a.mcap"))):
        bag = arguments(source, tmp_path / "out.csv", command_topic=["/c"], joints=["j1"])
        assert command.run(bag) == 0
        assert seen == {
            "source": source,
            "state_topic": "/joint_states",
            "command_topic": ["/c"],
            "joints": ["j1"],
        }


@pytest.mark.parametrize(
    ("source", "out", "message"),
    [
        ("log.json", "out.json", "found the ending '.json', expected a file name ending in .csv"),
        ("nowhere.bag", "out.csv", "nowhere.bag: found no such file"),
        ("nowhere.json", "out.csv", "nowhere.json: found no such file"),
        ("log.txt", "out.csv", "log.txt: found the ending '.txt'"),
        (".", "out.csv", "--command-topic: found nothing"),
    ],
)
def test_errors_say_where_in_one_line(log, tmp_path, source, out, message):
    (tmp_path / "log.txt").touch()
    with pytest.raises(InputError) as error:
        command.run(arguments(tmp_path / source, tmp_path / out))
    assert message in str(error.value)
    assert not (tmp_path / "out.csv").exists()
