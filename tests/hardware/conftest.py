"""Programs that record while other tests run: what they write takes its time."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from virtual_bench import IDENTIFIED, PORTS, SECONDS, robot_file


@pytest.fixture(autouse=True)
def state(tmp_path_factory, monkeypatch):
    """A state folder of each test's own, for the journals of ports."""
    folder = tmp_path_factory.mktemp("state")
    monkeypatch.setenv("XDG_STATE_HOME", str(folder))
    return folder


def start(*arguments, state):
    environment = os.environ | {"XDG_STATE_HOME": str(state)}
    command = [sys.executable, "-m", "sim2real", *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)


@pytest.fixture(scope="session")
def recorders(tmp_path_factory):
    """One program recording through each kind of port, into the folder that comes with them."""
    folder = tmp_path_factory.mktemp("recorded")
    law = [f"--{name}={value}" for name, value in IDENTIFIED.items()]
    lossy = ["--loss", "0.02", "--noise", "0.001"]
    servos = {
        kind: start("virtual-servo", *law, *lossy, *more, state=folder)
        for kind, more in PORTS.items()
    }
    programs = {}
    for kind, servo in servos.items():
        port = servo.stdout.readline().removeprefix("port: ").strip()
        programs[kind] = start(
            "record", "steps", "--seconds", str(SECONDS), "--robot", str(robot_file(folder, 1)),
            "--port", port, "--ids", "1", f"--inertia={IDENTIFIED['inertia']}",
            "--out", str(folder / f"{kind}.csv"), state=folder,
        )  # fmt: skip
    yield folder, programs
    for program in (*programs.values(), *servos.values()):
        program.terminate()
        program.wait(10)
        program.stdout.close()


@pytest.fixture(scope="session")
def recorded(recorders):
    """Folder of the finished recordings, what each program said and its exit status."""
    folder, programs = recorders
    said = {kind: program.communicate(timeout=90)[0] for kind, program in programs.items()}
    return folder, said, {kind: program.returncode for kind, program in programs.items()}
