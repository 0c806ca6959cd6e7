"""Whatever a recording holds, every verb has a result or refuses it with an InputError.

What comes out can be written as strict JSON, which knows neither NaN nor infinity.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from simulated import INERTIA, KD, KP, LATENCY, recording, robot

import sim2real as s2r
from sim2real.commands.streams import plain
from sim2real.diagnose.result import write_diagnosis
from sim2real.errors import InputError
from sim2real.model import JointModel, Model, read_model, write_model
from sim2real.ranges.entry import write_ranges
from sim2real.recording import Load, Recording
from sim2real.robot import Link, Robot

BASE = recording(1, "bench", seconds=2.0)
BENCH = robot("j1")
SERVO = Model(joints={"j1": JointModel(KP, KD, LATENCY, INERTIA)})
SWIMMER = Robot(
    "swimmer",
    (Link("head", 0.5, 0.2, 0.1, 0.1), Link("tail", 0.1, 0.1, 0.02, 0.1)),
    BENCH.joints,
)

Change = Callable[[Recording], Recording]


def changed(**columns: Callable[[Recording], np.ndarray]) -> Change:
    return lambda r: replace(r, **{name: of(r) for name, of in columns.items()})


def lacking(values: np.ndarray, start: int, length: int, every: int) -> np.ndarray:
    out = values.copy()
    out[start : start + length : every] = np.nan
    return out


def switched_off(values: np.ndarray, row: int) -> np.ndarray:
    return np.where(np.arange(len(values))[:, None] >= row, np.nan, values)


SCALES = st.sampled_from([0.0, 1e-12, 1e-6, 1e-3, -1.0, 0.3, 3.0, 57.3, 1e3])
ROWS = st.integers(0, BASE.t.size - 1)
CHANGES: st.SearchStrategy[Change] = st.one_of(
    st.builds(lambda by: changed(position=lambda r: by * r.position), SCALES),
    st.builds(lambda by: changed(command=lambda r: by * r.command), SCALES),
    st.builds(
        lambda by: changed(command=lambda r: by * r.command, position=lambda r: by * r.position),
        SCALES,
    ),
    st.builds(
        lambda by: changed(t=lambda r: by * r.t), st.sampled_from([1e-6, 1e-3, 0.2, 3.0, 1e3, 1e6])
    ),
    st.builds(
        lambda rows: changed(position=lambda r: np.roll(r.position, rows, axis=0)),
        st.integers(-30, 30),
    ),
    st.builds(lambda by: changed(position=lambda r: r.position + by), st.floats(-9, 9)),
    st.just(changed(command=lambda r: r.position, position=lambda r: r.command)),
    st.just(changed(position=lambda r: r.command)),
    st.builds(lambda a, b: lambda r: r.between(min(a, b), max(a, b) + 1), ROWS, ROWS),
    st.builds(
        lambda k: (
            lambda r: replace(r, t=r.t[::k], command=r.command[::k], position=r.position[::k])
        ),
        st.integers(2, 20),
    ),
    st.builds(
        lambda a, n, k: changed(position=lambda r: lacking(r.position, a, n, k)),
        ROWS,
        st.integers(1, 100),
        st.sampled_from([1, 1, 2, 7]),
    ),
    st.builds(lambda a: changed(command=lambda r: switched_off(r.command, a)), ROWS),
    st.builds(
        lambda step: changed(position=lambda r: step * np.round(r.position / step)),
        st.sampled_from([1e-3, 0.05, 0.5]),
    ),
    st.builds(
        lambda by: changed(loads=lambda r: {"j1": Load(by * INERTIA)}),
        st.sampled_from([1e-9, 0.1, 10.0, 1e3]),
    ),
    st.just(changed(loads=lambda r: {})),
    st.builds(
        lambda a, gap: changed(t=lambda r: np.where(np.arange(r.t.size) > a, r.t + gap, r.t)),
        ROWS,
        st.sampled_from([-0.0199, 0.5, 2.0]),
    ),
)


@st.composite
def recordings(draw: st.DrawFn) -> Recording:
    """A recorded servo, and up to three things that went wrong."""
    out = BASE
    for change in draw(st.lists(CHANGES, min_size=1, max_size=3)):
        out = change(out)
    return out


def swum(bench: Recording) -> Recording:
    return replace(
        bench,
        kind="pool",
        medium="water",
        loads={},
        columns={
            "body.x_m": 0.05 * bench.t,
            "body.y_m": np.where(np.arange(bench.t.size) % 9, 0.0, np.nan),
            "body.yaw_rad": bench.position[:, 0],
        },
    )


def check(bench: Recording, folder: Path) -> object:
    str(s2r.check(bench))
    return s2r.check(bench, BENCH)


def identify(bench: Recording, folder: Path) -> object:
    found = s2r.identify(bench, BENCH)
    write_model(found, folder / "model.json")
    assert read_model(folder / "model.json").joints.keys() == found.joints.keys()
    return str(found)


def diagnose(bench: Recording, folder: Path) -> object:
    found = s2r.diagnose(bench, BENCH)
    write_diagnosis(found, folder / "diagnosis.json", "enriched.json")
    write_model(found.model, folder / "enriched.json")
    return str(found)


def diagnose_swim(bench: Recording, folder: Path) -> object:
    found = s2r.diagnose(swum(bench), SWIMMER, SERVO)
    write_diagnosis(found, folder / "diagnosis.json", "enriched.json")
    return str(found)


def posterior(bench: Recording, folder: Path) -> object:
    return str(s2r.posterior(bench, BENCH, SERVO, steps=10, walkers=8))


def ranges(bench: Recording, folder: Path) -> object:
    found = s2r.ranges(bench, BENCH, SERVO, steps=10, walkers=8)
    write_ranges(found.ranges, folder / "ranges.json")
    return str(found.ranges)


def predict(bench: Recording, folder: Path) -> object:
    found = s2r.predict(bench, BENCH, SERVO)
    return {"/".join(key): error for key, error in found.rmse.items()}


def calibrate(bench: Recording, folder: Path) -> object:
    found = s2r.calibrate(swum(bench), SWIMMER, SERVO)
    write_model(found.model, folder / "calibrated.json")
    return str(found)


def simulate(bench: Recording, folder: Path) -> object:
    return str(s2r.simulate(swum(bench), SWIMMER, SERVO, fidelity="twin"))


def density(bench: Recording, folder: Path) -> object:
    return s2r.density(SWIMMER)


# So many examples that all verbs together take half a minute.
VERBS: dict[Callable[[Recording, Path], object], int] = {
    check: 40,
    identify: 20,
    predict: 40,
    posterior: 20,
    ranges: 8,
    simulate: 20,
    calibrate: 3,
    diagnose: 4,
    diagnose_swim: 2,
    density: 1,
}


@pytest.mark.filterwarnings("ignore:bench")  # findings about these recordings
@pytest.mark.parametrize("verb", VERBS, ids=lambda verb: verb.__name__)
def test_any_recording(verb: Callable[[Recording, Path], object], tmp_path: Path) -> None:
    @settings(
        max_examples=VERBS[verb],
        deadline=None,
        derandomize=True,
        database=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(bench=recordings())
    def refused_or_done(bench: Recording) -> None:
        try:
            result = verb(bench, tmp_path)
        except InputError as error:
            assert "\n" not in str(error)
            return
        json.dumps(plain(result), allow_nan=False)
        for written in tmp_path.glob("*.json"):
            json.loads(written.read_text(), parse_constant=pytest.fail)

    refused_or_done()
