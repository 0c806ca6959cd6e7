"""Whatever a recording holds, every verb has a result or refuses it with an InputError.

What comes out can be written as strict JSON, which knows neither NaN nor infinity.
"""

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
from sim2real.diagnose.result import write_diagnosis
from sim2real.errors import InputError
from sim2real.model import JointModel, Model, read_model, write_model
from sim2real.output import finite_json
from sim2real.ranges.entry import write_ranges
from sim2real.recording import Load, Recording
from sim2real.robot import Link, Robot

BASE = recording(1, "bench", seconds=2.0)
BENCH = robot("j1")
SERVO = Model(joints={"j1": JointModel(KP, KD, LATENCY, INERTIA)})
SWIMMER = Robot(
    "swimmer", (Link("head", 0.5, 0.2, 0.1, 0.1), Link("tail", 0.1, 0.1, 0.02, 0.1)), BENCH.joints
)

Change = Callable[[Recording], Recording]


def changes(values: st.SearchStrategy, **columns: Callable) -> st.SearchStrategy[Change]:
    """Changes of columns by functions of the recording and a drawn value."""
    return values.map(
        lambda by: lambda r: replace(r, **{name: of(r, by) for name, of in columns.items()})
    )


def lacking(position: np.ndarray, where: tuple[int, int, int]) -> np.ndarray:
    start, length, every = where
    out = position.copy()
    out[start : start + length : every] = np.nan
    return out


SCALES = st.sampled_from([0.0, 1e-12, 1e-6, 1e-3, -1.0, 0.3, 3.0, 57.3, 1e3])
ROWS = st.integers(0, BASE.t.size - 1)
ROW = np.arange(BASE.t.size)[:, None]
TIMES = st.sampled_from([1e-6, 1e-3, 0.2, 3.0, 1e3, 1e6])
GAPS = st.tuples(ROWS, st.sampled_from([-0.0199, 0.5, 2.0]))
CHANGES: st.SearchStrategy[Change] = st.one_of(
    changes(SCALES, position=lambda r, by: by * r.position),
    changes(SCALES, command=lambda r, by: by * r.command),
    changes(SCALES, command=lambda r, by: by * r.command, position=lambda r, by: by * r.position),
    changes(TIMES, t=lambda r, by: by * r.t),
    changes(st.integers(-30, 30), position=lambda r, by: np.roll(r.position, by, axis=0)),
    changes(st.floats(-9, 9), position=lambda r, by: r.position + by),
    changes(st.none(), command=lambda r, _: r.position, position=lambda r, _: r.command),
    changes(st.none(), position=lambda r, _: r.command),
    st.tuples(ROWS, ROWS).map(lambda x: lambda r: r.between(min(x), max(x) + 1)),
    changes(
        st.integers(2, 20),
        t=lambda r, k: r.t[::k],
        command=lambda r, k: r.command[::k],
        position=lambda r, k: r.position[::k],
    ),
    changes(
        st.tuples(ROWS, st.integers(1, 100), st.sampled_from([1, 1, 2, 7])),
        position=lambda r, where: lacking(r.position, where),
    ),
    changes(ROWS, command=lambda r, a: np.where(ROW[: r.t.size] >= a, np.nan, r.command)),
    changes(
        st.sampled_from([1e-3, 0.05, 0.5]),
        position=lambda r, step: step * np.round(r.position / step),
    ),
    changes(st.sampled_from([1e-9, 0.1, 10.0, 1e3]), loads=lambda r, x: {"j1": Load(x * INERTIA)}),
    changes(st.none(), loads=lambda r, _: {}),
    changes(GAPS, t=lambda r, x: np.where(np.arange(r.t.size) > x[0], r.t + x[1], r.t)),
)


@st.composite
def recordings(draw: st.DrawFn) -> Recording:
    """A recorded servo, and up to three things that went wrong."""
    out = BASE
    for change in draw(st.lists(CHANGES, min_size=1, max_size=3)):
        out = change(out)
    return out


def swum(bench: Recording) -> Recording:
    y = np.where(np.arange(bench.t.size) % 9, 0.0, np.nan)
    columns = {"body.x_m": 0.05 * bench.t, "body.y_m": y, "body.yaw_rad": bench.position[:, 0]}
    return replace(bench, kind="pool", medium="water", loads={}, columns=columns)


def check(bench: Recording, folder: Path) -> object:
    str(s2r.check(bench))
    return s2r.check(bench, BENCH)


def identify(bench: Recording, folder: Path) -> object:
    found = s2r.identify(bench, BENCH)
    write_model(found, folder / "model.json")
    assert read_model(folder / "model.json").joints.keys() == found.joints.keys()
    return str(found)


def diagnosed(recording: Recording, folder: Path, *known: object) -> object:
    found = s2r.diagnose(recording, *known)
    write_diagnosis(found, folder / "diagnosis.json", "enriched.json")
    write_model(found.model, folder / "enriched.json")
    return str(found)


def ranges(bench: Recording, folder: Path) -> object:
    found = s2r.ranges(bench, BENCH, SERVO, steps=10, walkers=16)
    write_ranges(found.ranges, folder / "ranges.json")
    return str(found.ranges)


def predict(bench: Recording, folder: Path) -> object:
    found = s2r.predict(bench, BENCH, SERVO)
    return {"/".join(key): error for key, error in found.rmse.items()}


def calibrate(bench: Recording, folder: Path) -> object:
    found = s2r.calibrate(swum(bench), SWIMMER, SERVO)
    write_model(found.model, folder / "calibrated.json")
    return str(found)


CHAIN, SWIM = {"steps": 10, "walkers": 16}, (SWIMMER, SERVO)
# So many examples that all verbs together take half a minute.
VERBS: dict[str, tuple[int, Callable[[Recording, Path], object]]] = {
    "check": (40, check),
    "identify": (20, identify),
    "predict": (40, predict),
    "posterior": (20, lambda bench, _: str(s2r.posterior(bench, BENCH, SERVO, **CHAIN))),
    "ranges": (8, ranges),
    "simulate": (20, lambda bench, _: str(s2r.simulate(swum(bench), *SWIM, fidelity="twin"))),
    "calibrate": (3, calibrate),
    "diagnose": (4, lambda bench, folder: diagnosed(bench, folder, BENCH)),
    "diagnose a swim": (2, lambda bench, folder: diagnosed(swum(bench), folder, SWIMMER, SERVO)),
}


@pytest.mark.filterwarnings("ignore:bench")  # findings about these recordings
@pytest.mark.parametrize("verb", VERBS)
def test_any_recording(verb: str, tmp_path: Path) -> None:
    examples, run = VERBS[verb]

    @settings(
        max_examples=examples,
        deadline=None,
        derandomize=True,
        database=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(bench=recordings())
    def refused_or_done(bench: Recording) -> None:
        try:
            result = run(bench, tmp_path)
        except InputError as error:
            assert "\n" not in str(error)
            return
        json.dumps(finite_json(result), allow_nan=False)
        for written in tmp_path.glob("*.json"):
            json.loads(written.read_text(), parse_constant=pytest.fail)

    refused_or_done()
