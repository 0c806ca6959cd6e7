"""Files and streams of commands: no result replaces an input, and none is lost."""

import json
import os
import shutil
import socket
import stat
import subprocess
import sys
import threading
from functools import wraps
from pathlib import Path

import pytest

from sim2real import cli
from sim2real.cli import main
from sim2real.commands.files import WRITTEN
from sim2real.errors import InputError
from sim2real.output import beside, check_writable, write_whole

ROOT = Path(__file__).parents[2]
DATA = ROOT / "datasets" / "servo_steps"
MODEL = ROOT / "reports" / "servo_steps" / "model.json"
SERVO = ("servos", "xl330_gain800", "--out")
"""A command that writes a file and prints, in a second."""


def sim2real(*arguments: str, before: str = "", **how: object) -> subprocess.CompletedProcess[str]:
    """The command line in a process of its own, after the statements ``before``."""
    program = f"import sys\n{before}\nfrom sim2real.cli import main\nsys.exit(main(sys.argv[1:]))"
    command = [sys.executable, "-c", program, *arguments]
    search = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(command, text=True, env=search, **{"capture_output": True, **how})


def one_line(text: str) -> str:
    (line,) = text.splitlines()
    return line


@pytest.fixture
def bench(tmp_path, monkeypatch):
    for name in ("steps.csv", "steps.json", "chirp.csv", "chirp.json", "robot.toml"):
        shutil.copy(DATA / name, tmp_path)
    shutil.copy(MODEL, tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    "call",
    [
        "identify steps.csv --robot robot.toml --out {}",
        "diagnose chirp.csv --references steps.csv --robot robot.toml --out {}",
        "ranges steps.csv --robot robot.toml --model model.json --out {}",
        "calibrate steps.csv --robot robot.toml --model model.json --out {}",
        "predict model.json steps.csv --out {}",
        "predict model.json steps.csv --out p.csv --mcap {}",
        "simulate model.json steps.csv --robot robot.toml --out s.csv --plot {}",
        "density robot.toml --model model.json --out {}",
        "density robot.toml --plot {}",
        "design --robot robot.toml --model model.json --out {}",
        "export-servo model.json --to json --recordings steps.csv --robot robot.toml --out {}",
        "track robot.toml --camera model.json --servo steps.csv --out {}",
        "record steps.csv --robot robot.toml --overwrite --out {}",
        "servos add model.json --out {}",
    ],
)
def test_an_output_on_an_input_is_refused_before_any_work(call, bench, capsys):
    os.link("steps.csv", "hard.csv")
    os.symlink("model.json", "soft.json")
    before = {path.name: path.read_bytes() for path in bench.iterdir()}
    inputs = {
        "robot.toml": ["robot.toml", str(bench / "robot.toml")],
        "steps.csv": ["steps.csv", "steps.json", "hard.csv", "./../" + bench.name + "/steps.csv"],
        "model.json": ["model.json", "soft.json"],
    }
    for read, outputs in inputs.items():
        for out in outputs if read in call else ():
            assert main(call.format(out).split()) == 2, out
            assert "which the command reads" in one_line(capsys.readouterr().err)
    assert {path.name: path.read_bytes() for path in bench.iterdir()} == before


def test_the_json_of_an_output_is_an_output(bench, capsys):
    assert main(["predict", "model.json", "steps.csv", "--out", "model.csv"]) == 2
    assert "model.json" in one_line(capsys.readouterr().err)
    assert (bench / "model.json").read_bytes() == MODEL.read_bytes()


def test_one_file_for_two_outputs_is_refused(bench, capsys):
    assert (
        main(["predict", "model.json", "steps.csv", "--out", "a.mcap", "--mcap", "./a.mcap"]) == 2
    )
    assert "named twice" in one_line(capsys.readouterr().err)


def test_every_option_that_is_written_is_known():
    """An option whose help says so, of any command."""
    commands = cli.parser()._subparsers._group_actions[0].choices
    for name, command in commands.items():
        for action in command._actions:
            if action.type is not Path or not action.option_strings:
                continue
            if "to write" in (action.help or ""):
                assert action.dest in WRITTEN, f"{name} {action.option_strings}"


@pytest.mark.parametrize(
    "call",
    [
        "export {} --out p.npz",
        "swim {} --target 1,1 --virtual",
        "evaluate {} --robot robot.toml --model model.json",
        "import {} --out a.csv",
    ],
)
def test_an_input_without_an_end_is_refused(call, bench, capsys):
    os.mkfifo("pipe")
    assert main(call.format("pipe").split()) == 2
    assert "pipe: found a pipe, expected a file" in one_line(capsys.readouterr().err)


def test_a_link_is_followed(tmp_path):
    (tmp_path / "real.json").write_text("old")
    (tmp_path / "folder").mkdir()
    for link, target in (("a", "real.json"), ("b", "a"), ("folder/c", "../new.json")):
        (tmp_path / link).symlink_to(target)
        write_whole(tmp_path / link, f"by {link}")
        assert (tmp_path / link).is_symlink()
        assert (tmp_path / link).read_text() == f"by {link}"
    assert (tmp_path / "real.json").read_text() == "by b"
    assert (tmp_path / "new.json").read_text() == "by folder/c"
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(InputError, match="loop"):
        check_writable(tmp_path / "loop")


def test_a_device_and_a_pipe_are_written_through(tmp_path):
    device = os.stat(os.devnull)
    assert write_whole(os.devnull, "text") == Path(os.devnull)
    assert os.path.samestat(os.stat(os.devnull), device)
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    read = []
    reader = threading.Thread(target=lambda: read.append(pipe.read_bytes()))
    reader.start()
    while True:  # until the reader has opened it
        try:
            write_whole(pipe, "text")
            break
        except InputError as error:
            assert "no program reads" in str(error)
    reader.join()
    assert read == [b"text"]
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    assert beside(pipe, "pipe.html") == Path(os.devnull)
    assert list(tmp_path.iterdir()) == [pipe]


def test_a_socket_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind("socket")
        with pytest.raises(InputError, match="a disk or a socket"):
            check_writable("socket")


def test_permissions_follow_the_umask_and_an_existing_file_keeps_its_own(tmp_path):
    before = os.umask(0o027)
    try:
        write_whole(tmp_path / "new", "")
        (tmp_path / "kept").touch()
        (tmp_path / "kept").chmod(0o604)
        write_whole(tmp_path / "kept", "")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "new").stat().st_mode) == 0o640
    assert stat.S_IMODE((tmp_path / "kept").stat().st_mode) == 0o604


def test_standard_output_as_a_file_has_the_result_alone(tmp_path):
    done = sim2real(*SERVO, "/dev/stdout")
    assert done.returncode == 0
    assert json.loads(done.stdout)["schema"] == "sim2real.model/1"
    with (tmp_path / "to").open("w") as file:
        sim2real(*SERVO, "/dev/stdout", capture_output=False, stdout=file, stderr=-3)
    assert (tmp_path / "to").read_text() == done.stdout


@pytest.mark.parametrize(
    ("before", "reason"),
    [
        ("import os; os.dup2(os.open('/dev/full', 1), 1)", "No space left"),
        ("import os; os.close(1); sys.stdout = None", "closed"),
        ("sys.stdout.close()", "closed"),
    ],
)
def test_a_standard_output_that_fails_costs_no_result(tmp_path, before, reason):
    out = tmp_path / "model.json"
    done = sim2real(*SERVO, str(out), before=before)
    assert done.returncode == 1
    assert reason in one_line(done.stderr)
    assert json.loads(out.read_text())["schema"] == "sim2real.model/1"


def test_a_reader_that_stops_costs_no_result_and_no_words(tmp_path):
    reading, writing = os.pipe()
    os.close(reading)
    out = tmp_path / "model.json"
    how = {"stdout": writing, "stderr": subprocess.PIPE, "capture_output": False}
    done = sim2real(*SERVO, str(out), **how)
    os.close(writing)
    assert (done.returncode, done.stderr) == (1, "")
    assert out.exists()


SMALL = """
import resource, signal
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))
sys.dont_write_bytecode = True
"""


def test_a_full_disk_prints_the_result(tmp_path):
    """As the temporary folder is full, too."""
    out = tmp_path / "model.json"
    out.write_text("old")
    done = sim2real(*SERVO, str(out), before=SMALL)
    assert done.returncode == 1
    assert "model.json: File too large; the result is printed above" in one_line(done.stderr)
    assert json.loads(done.stdout[: done.stdout.rindex("}") + 1])["joints"]
    assert out.read_text() == "old"
    assert list(tmp_path.iterdir()) == [out]


def test_a_full_device_keeps_the_result_in_the_temporary_folder(tmp_path):
    before = f"import tempfile; tempfile.tempdir = {str(tmp_path)!r}"
    done = sim2real(*SERVO, "/dev/full", before=before)
    assert done.returncode == 1
    assert "/dev/full: No space left on device; the result is in" in one_line(done.stderr)
    (kept,) = tmp_path.glob("sim2real-*/full")
    assert str(kept) in done.stderr
    assert json.loads(kept.read_text())["joints"]


def test_a_folder_lost_during_the_fit_costs_no_result(bench, capsys, monkeypatch):
    """Nor inputs that are gone when their digests are taken."""
    from sim2real import verbs

    identify = verbs.identify

    @wraps(identify)
    def destructive(*arguments, **more):
        (bench / "robot.toml").unlink()
        shutil.rmtree(bench / "out")
        (bench / "out").write_text("")
        return identify(*arguments, **more)

    (bench / "out").mkdir()
    monkeypatch.setattr(verbs, "identify", destructive)
    monkeypatch.setattr("tempfile.tempdir", str(bench))
    call = "identify steps.csv --robot robot.toml --law pd --no-plots --out out/model.json"
    assert main([*call.split(), "--json"]) == 1
    printed = capsys.readouterr()
    assert "out/model.json: " in printed.err.splitlines()[-1]
    (kept,) = bench.glob("sim2real-*/model.json")
    assert json.loads(printed.out) == json.loads(kept.read_text())
    inputs = json.loads(kept.read_text())["provenance"]["inputs"]
    assert inputs["robot.toml"].startswith("not readable")


def test_a_removed_working_directory_is_one_line(tmp_path):
    gone = tmp_path / "gone"
    gone.mkdir()
    before = f"import os; os.rmdir({str(gone)!r})"
    done = sim2real(*SERVO, "model.json", before=before, cwd=gone)
    assert done.returncode == 2
    assert "No such file or directory" in one_line(done.stderr)
    gone.mkdir()
    done = sim2real(*SERVO, str(tmp_path / "model.json"), before=before, cwd=gone)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "model.json").exists()


def test_an_error_of_the_operating_system_is_one_line(tmp_path, capsys, monkeypatch):
    def fails(options):
        raise PermissionError(13, "Permission denied", "/somewhere")

    monkeypatch.setattr("sim2real.commands.servos.run", fails)
    assert main(["servos"]) == 1
    line = one_line(capsys.readouterr().err)
    assert line == "sim2real servos: /somewhere: Permission denied"


def test_data_are_synced_before_the_rename(tmp_path, monkeypatch):
    done, sync, rename = [], os.fsync, os.replace
    monkeypatch.setattr(os, "fsync", lambda file: done.append("sync") or sync(file))
    monkeypatch.setattr(os, "replace", lambda a, b: done.append("rename") or rename(a, b))
    write_whole(tmp_path / "result", "text")
    assert done == ["sync", "rename"]
