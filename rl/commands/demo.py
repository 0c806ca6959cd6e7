"""``sim2real demo``: the chain on the shipped data, ending in one HTML page."""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from sim2real.check import check
from sim2real.commands.diagnose import write as write_diagnosis
from sim2real.commands.identify import most_telling
from sim2real.diagnose.diagnose import diagnose
from sim2real.errors import InputError
from sim2real.model import write_model
from sim2real.output import check_writable
from sim2real.recording import Recording, read_recording
from sim2real.report.diagnosis import diagnosis_section
from sim2real.report.identification import Fit, identification_section
from sim2real.report.page import write_page
from sim2real.report.recordings import recordings_section
from sim2real.report.table import fit_report
from sim2real.robot import read_robot
from sim2real.servo.identify import identify
from sim2real.servo.replay import Replay, replay

STAGES = ("check", "identify", "diagnose", "calibrate", "ranges", "train", "ablate")
_TELLING = ("chirp", "steps")
_SHOWN = "square"
"""Recording that the page shows beside the one held out: the paper's own test signal."""


def run(options: argparse.Namespace) -> int:
    """Check, identify, replay, and write ``index.html`` and ``model.json``."""
    page = check_writable(options.out / "index.html")
    paths = sorted(options.data.glob("*.csv"), reverse=True)  # the chirp last: it is held out
    if not paths:
        raise InputError(options.data, "", "no recordings", "NAME.csv files, NAME.json beside each")
    robot = read_robot(options.data / "robot.toml")
    with _stage("read", f"{len(paths)} recordings of {options.data}"):
        recordings = [read_recording(path) for path in paths]
    with _stage("check", "clocks, noise, motion"):
        checks = [check(recording, robot) for recording in recordings]
    with _stage("identify", "gains and latency of each servo"):
        model = identify(recordings, robot, seed=options.seed)
    with _stage("diagnose", "which physics the servos leave out"):
        found = diagnose(_two(recordings), robot, seed=options.seed)
    write_diagnosis(found, options.out / "diagnosis.json")
    with _stage("replay", "the model beside what was recorded"):
        replays = replay(model, recordings)
    write_model(model, options.out / "model.json")
    with _stage("report", str(page)):
        write_page(
            page,
            robot.name,
            f"{len(recordings)} recordings, {len(model.joints)} servos identified",
            [
                recordings_section(recordings, checks),
                identification_section(model, _shown(replays)),
                diagnosis_section(found),
            ],
            model.provenance,
            stages=[("recordings", True)]
            + [(name, name in ("check", "identify", "diagnose")) for name in STAGES],
        )
    print("\n" + fit_report(model))
    print(f"\nreport: {page}")
    return 0


def _two(recordings: Sequence[Recording]) -> list[Recording]:
    """Two recordings of different kinds: enough, and quick."""
    telling = [one for one in recordings if one.name in _TELLING]
    return telling or list(recordings[:2])


def _shown(replays: Sequence[Replay]) -> list[Fit]:
    telling = list(most_telling(replays).values())
    more = [one for one in replays if one.recording.name == _SHOWN and one not in telling]
    return [(r.recording, r.joint, r.predicted, r.held_out) for r in [*more[:1], *telling]]


@contextmanager
def _stage(name: str, what: str) -> Iterator[None]:
    """Print a line for one stage, and how long it took."""
    print(f"{name:10}{what}", end=" ", flush=True)
    start = time.perf_counter()
    yield
    print(f"({time.perf_counter() - start:.1f} s)", flush=True)
