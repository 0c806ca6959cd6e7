"""Jobs on this machine: resumed when killed, left alone when done, named when they fail."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from watching import (
    is_alive,
    kill_in_the_middle,
    process_of,
    reached,
    results,
    starts,
    uninterrupted,
    wait_for,
    walks,
)

import sim2real.executor.__main__ as worker
from sim2real.errors import InputError
from sim2real.executor import Job, map_jobs, run_jobs
from sim2real.executor.job import NOT_STARTED
from sim2real.executor.run import slots, visible_gpus

DRIVER = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it
from pathlib import Path
from watching import walks
from sim2real.executor import Job, run_jobs
folder = Path(sys.argv[1])
helped = Job("h", "random_walk:start_helper", {}, folder / "h")
run_jobs([*walks(folder, steps=60, count=1, held=[0]), helped], at_once=2)
"""


def test_a_killed_job_goes_on_and_ends_the_same(tmp_path):
    jobs = walks(tmp_path / "run", steps=60, held=[2])
    killed = kill_in_the_middle(jobs[2].folder)
    outcomes = run_jobs(jobs, at_once=2)
    assert [str(outcome) for outcome in outcomes] == [f"seed{seed}: done" for seed in range(4)]
    assert killed.result()
    first, second = starts(jobs[2].folder)
    assert (first, second >= 30) == (0, True)
    assert [starts(jobs[other].folder) for other in (0, 1, 3)] == [[0]] * 3
    assert results(tmp_path / "run") == uninterrupted(tmp_path / "reference", steps=60)
    assert "at step 60" in (jobs[2].folder / "log.txt").read_text()


def test_what_is_done_is_left_alone_and_other_options_are_not(tmp_path):
    jobs = walks(tmp_path, steps=10, count=2)
    run_jobs(jobs)
    before = (jobs[0].folder / "done.json").stat().st_mtime_ns
    longer = Job(jobs[1].name, jobs[1].function, jobs[1].options | {"steps": 20}, jobs[1].folder)
    outcomes = run_jobs([jobs[0], longer])
    assert [outcome.failure for outcome in outcomes] == [None, None]
    assert (jobs[0].folder / "done.json").stat().st_mtime_ns == before
    assert starts(jobs[0].folder) == [0]
    assert starts(jobs[1].folder) == [0, 0]  # the walk does not go on from other options
    assert json.loads((jobs[1].folder / "done.json").read_text())["options"]["steps"] == 20
    run_jobs([Job("seed0", "random_walk:raise_error", {}, jobs[0].folder)])
    assert run_jobs([jobs[0]])[0].failure is None
    assert starts(jobs[0].folder) == [0, 10], "done again, as others have overwritten it"


def test_failures_are_named_and_the_others_go_on(tmp_path):
    whys = {
        "raise_error": "ValueError: a fish out of water",
        "find_input_wanting": "model.json: kp: found -1, expected a positive number",
        "die": "killed by SIGKILL, 2 times",
        "leave_early": "ended early, with status 0",
        "missing": "missing: function: found no missing in random_walk, expected a function",
        "finish_then_crash": None,
    }
    jobs = [Job(name, f"random_walk:{name}", {}, tmp_path / name) for name in whys]
    outcomes = run_jobs(jobs, at_once=3, retries=1)
    for outcome, (name, why) in zip(outcomes, whys.items(), strict=True):
        told = f"{why}; see {tmp_path / name / 'log.txt'}" if why else "done"
        assert str(outcome) == f"{name}: {told}"
    assert "Traceback" in (tmp_path / "raise_error" / "log.txt").read_text()
    assert (tmp_path / "die" / "log.txt").read_text() == "about to die\n" * 2
    assert not list(tmp_path.glob("[!f]*/done.json"))


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_jobs_end_with_the_program_that_started_them(tmp_path, how):
    paths = os.pathsep.join([str(Path(__file__).parent), os.getcwd()])
    driver = subprocess.Popen(
        [sys.executable, "-c", DRIVER, str(tmp_path)],
        env=os.environ | {"PYTHONPATH": paths},
        stderr=subprocess.PIPE,
    )
    wait_for(lambda: reached(tmp_path / "0", 30))
    helper = wait_for(lambda: int((tmp_path / "h" / "helper").read_text()))
    processes = [process_of(tmp_path / "0"), process_of(tmp_path / "h"), helper]
    assert all(map(is_alive, processes))
    driver.send_signal(how)
    driver.communicate()
    assert driver.returncode != 0
    wait_for(lambda: not any(map(is_alive, processes)))
    assert run_jobs(walks(tmp_path, steps=60, count=1))[0].failure is None
    assert starts(tmp_path / "0")[1] >= 30


def test_one_process_at_a_time_works_in_a_folder(tmp_path, monkeypatch):
    monkeypatch.setattr(worker, "PATIENCE_S", 0.0)
    with worker.locked(tmp_path):
        expected = f"in use by process {os.getpid()} on .*, expected no process"
        with pytest.raises(InputError, match=expected), worker.locked(tmp_path):
            pass
    with worker.locked(tmp_path):
        pass


def test_jobs_side_by_side_get_gpus_of_their_own(tmp_path, monkeypatch):
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "3,5")
    jobs = [Job(n, "random_walk:tell_environment", {}, tmp_path / n) for n in "ab"]
    run_jobs(jobs, gpus=1)
    told = [json.loads((job.folder / "environment.json").read_text()) for job in jobs]
    assert [one["CUDA_VISIBLE_DEVICES"] for one in told] == ["3", "5"]
    assert [one["OMP_NUM_THREADS"] for one in told] == ["1", "1"]


@pytest.mark.parametrize(
    ("at_once", "gpus", "expected"),
    [
        (None, 1, ["3", "5"]),
        (1, 1, ["3"]),
        (None, 2, ["3,5"]),
        (3, 0, ["", "", ""]),
    ],
)
def test_seats(monkeypatch, at_once, gpus, expected):
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "3,5")
    assert slots(at_once, gpus) == expected


def test_gpus_are_those_the_driver_names(tmp_path, monkeypatch):
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert visible_gpus() == []
    tool = tmp_path / "nvidia-smi"
    tool.write_text("#!/bin/sh\necho GPU-1f\necho GPU-2e\n")
    tool.chmod(0o755)
    assert visible_gpus() == ["GPU-1f", "GPU-2e"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"gpus": 3}, "--jobs: found 2 GPUs, expected enough for 1 at a time, 3 each"),
        ({"gpus": 1, "at_once": 3}, "--jobs: found 2 GPUs, expected enough for 3 at a time"),
        ({"at_once": 0}, "--jobs: found 0, expected at least 1"),
        ({"executor": "slurm"}, "--executor: found 'slurm', expected local or ray"),
        ({"executor": "ray"}, r"no Ray, .* pip install 'sim2real\[cluster\]'"),
    ],
)
def test_what_can_not_be_run(tmp_path, monkeypatch, options, message):
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "3,5")
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(InputError, match=message):
        run_jobs(walks(tmp_path, steps=10, count=1), **options)
    assert not list(tmp_path.iterdir())


def test_jobs_that_are_none(tmp_path):
    def refused(message, *jobs):
        with pytest.raises(InputError, match=message):
            run_jobs([Job(*job) for job in jobs])

    refused("found 'walk', expected package.module:function", ("a", "walk", {}, tmp_path))
    one, two = (vars(job).values() for job in walks(tmp_path, steps=10, count=2))
    for value in (tmp_path, (1, 2), float("nan"), {1: 2}):
        job = ("a", "random_walk:walk", {"seed": value}, tmp_path)
        refused("a: options: found .* JSON represents", job)
    refused("jobs: name: found seed0 2 times", one, one)
    refused("jobs: folder: found .* 2 times", one, ("other", *[*two][1:3], [*one][3]))
    assert run_jobs([]) == []


def test_calls_by_name_return_their_folders(tmp_path):
    calls = {str(seed): {"seed": seed, "steps": 10, "pause_s": 0.0} for seed in (0, 1)}
    folders = map_jobs("random_walk:walk", calls, tmp_path / "run")
    assert folders == [tmp_path / "run" / name for name in calls]
    assert results(tmp_path / "run") == uninterrupted(tmp_path / "one", steps=10, count=2)
    with pytest.raises(RuntimeError, match=r"^b: ValueError: a fish out of water; see [^;]+$"):
        map_jobs("random_walk:raise_error", {"b": {}}, tmp_path)


def test_no_job_starts_when_the_time_is_over(tmp_path):
    jobs = walks(tmp_path, steps=10, count=3)
    outcomes = run_jobs(jobs, at_once=1, seconds=0.0)
    assert [outcome.failure for outcome in outcomes] == [NOT_STARTED] * 3
    assert not list(tmp_path.iterdir())
    first = run_jobs(jobs[:1], at_once=1)
    assert run_jobs(jobs, at_once=1, seconds=0.0)[0] == first[0], "what is done is done"
