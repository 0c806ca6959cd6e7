"""A job for the tests: a random walk that can be killed at any moment and goes on."""

import json
import os
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np

from sim2real.errors import InputError
from sim2real.output import write_json

STEPS_A_CHECKPOINT = 10
HELD_AT = 30
LONGEST_HOLD_S = 120.0


def walk(folder, *, seed, steps, pause_s=0.1, held_until=""):
    """Walk ``steps`` steps, with a checkpoint and a pause after every ten.

    A walk that begins at 0 stays at step 30 until the file ``held_until`` exists, if one is named:
    so it can be killed there, however busy the machine is. One that resumes does not wait.
    """
    rng = np.random.default_rng(seed)
    state = _checkpoint(folder, {"seed": seed, "steps": steps}) or {
        "made_with": {"seed": seed, "steps": steps},
        "step": 0,
        "position": 0.0,
        "rng": rng.bit_generator.state,
    }
    rng.bit_generator.state = state["rng"]
    held = bool(held_until) and state["step"] == 0
    with (folder / "starts.txt").open("a") as starts:
        starts.write(f"{state['step']}\n")
    while state["step"] < steps:
        state["position"] += float(rng.normal(size=STEPS_A_CHECKPOINT).sum())
        state["step"] += STEPS_A_CHECKPOINT
        state["rng"] = rng.bit_generator.state
        write_json(folder / "walk.json", state)
        print("at step", state["step"])
        if held and state["step"] == HELD_AT:
            _wait_for(Path(held_until))
        time.sleep(pause_s)
    write_json(folder / "result.json", {"position": state["position"]})


def _wait_for(file):
    last = time.monotonic() + LONGEST_HOLD_S
    while not file.exists() and time.monotonic() < last:
        time.sleep(0.01)


def _checkpoint(folder, made_with):
    """The state to go on from, if there is one and it was made with the same options."""
    path = folder / "walk.json"
    state: dict[str, Any] | None = json.loads(path.read_text()) if path.exists() else None
    return state if state and state["made_with"] == made_with else None


def raise_error(folder):
    raise ValueError("a fish out of water")


def find_input_wanting(folder):
    raise InputError("model.json", "kp", "-1", "a positive number")


def die(folder):
    print("about to die", flush=True)
    os.kill(os.getpid(), signal.SIGKILL)


def finish_then_crash(folder):
    """Crash as some libraries do on the way out, when everything is written."""
    import atexit

    atexit.register(os.abort)


def leave_early(folder):
    raise SystemExit(0)


def tell_environment(folder):
    names = ("CUDA_VISIBLE_DEVICES", "OMP_NUM_THREADS")
    write_json(folder / "environment.json", {name: os.environ[name] for name in names})


def start_helper(folder):
    """Start another process, as a training with its own workers does, and wait."""
    helper = subprocess.Popen(["sleep", "300"])
    (folder / "helper").write_text(str(helper.pid))
    helper.wait()
