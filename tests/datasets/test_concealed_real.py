"""Sealed sets out of real recordings: reproducible, nothing leaks, what is hidden is there."""

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from sim2real.recording import read_recording

FOLDER = Path(__file__).parents[2] / "datasets" / "concealed"
MODULES = (
    "real", "backgrounds", "injections", "interventions", "real_effects", "real_files",
    "real_outside",
)  # fmt: skip
FEW = ["--null", "3", "--single", "3", "--double", "1", "--outside", "3"]


@pytest.fixture(scope="module")
def code(scripts):
    """The generator's modules by name."""
    with scripts(FOLDER, names=MODULES) as modules:
        yield modules


@pytest.fixture(scope="module")
def logs(code, realdata):
    groups = code["backgrounds"].backgrounds(realdata)
    return {log.name: log for group in groups.values() for log in group}


@pytest.fixture(scope="module")
def sets(code, realdata, tmp_path_factory):
    """Cases of T2 and T3: their folder and answer."""
    out = tmp_path_factory.mktemp("real")
    paths = [out / "t2", out / "t3"]
    code["real"].main([*map(str, paths), "--realdata", str(realdata), "--seed", "7"])
    cases = []
    for path in paths:
        answers = json.loads((path / "answers.json").read_text())
        cases.append([(path, answer) for answer in answers])
    return cases


def files(path, answer):
    name = answer["case"]
    return {p.stem: p for k in ("inputs", "heldout") for p in (path / k / name).glob("*.csv")}


def test_the_same_seed_gives_the_same_bytes(code, realdata, tmp_path):
    for run in ("first", "again"):
        outs = [str(tmp_path / run / tier) for tier in ("t2", "t3")]
        code["real"].main([*outs, "--realdata", str(realdata), "--seed", "5", *FEW])
    paths = sorted(p for p in (tmp_path / "first").rglob("*") if p.is_file())
    for path in paths:
        again = tmp_path / "again" / path.relative_to(tmp_path / "first")
        assert path.read_bytes() == again.read_bytes()


def test_no_kind_leaks_through_names_sizes_or_sidecars(code, sets):
    logs = code["backgrounds"]
    words = {*code["real_effects"].EFFECTS, *code["real_outside"].OUTSIDERS}
    words |= {"torque_off", "supply", "firmware", "kp", "seed", *logs.XL330, logs.DROP}
    words |= {"null", "trap", "single", "double", "outside"}
    told = re.compile(rf"\b({'|'.join(map(re.escape, words))})\b")
    for path, answer in sum(sets, []):
        for file in (path / "inputs" / answer["case"]).iterdir():
            text = file.read_text()
            assert not told.search(text), file
            assert re.fullmatch(r"(ref_[123]|a|b)\.(csv|json)|robot\.toml", file.name)
            if file.suffix == ".csv":
                header = text.split("\n", 1)[0]
                assert re.fullmatch(r"t_s(,j\d\.command_rad,j\d\.position_rad)+", header)
    kinds = {}
    for path, answer in sets[0]:  # of one background, all but disordered clocks are alike
        if not answer["clock_disturbed"]:
            rows = read_recording(files(path, answer)["a"]).t.size
            kinds.setdefault(answer["background"]["a"], set()).add(rows)
    assert all(len(rows) == 1 for rows in kinds.values())


def test_every_file_of_the_generator_is_hashed(code):
    assert {f"{name}.py" for name in MODULES} == set(code["real_files"].GENERATOR)
    with_it = [Path(sys.modules[name].__file__).read_text() for name in MODULES]
    local = {path.stem for path in FOLDER.glob("*.py")}
    used = set(re.findall(r"^(?:from|import) (\w+)", "\n".join(with_it), re.M)) & local
    assert used <= set(MODULES)


def test_what_is_hidden_is_there_and_only_in_its_windows(code, sets, logs):
    for path, answer in sets[0]:
        for name, file in files(path, answer).items():
            if name.startswith("ref") or answer["kind"] in ("null", "trap"):
                continue
            seen, log = read_recording(file), logs[answer["background"][name]]
            rows = np.searchsorted(log.t, seen.t)
            np.testing.assert_array_equal(log.t[rows], seen.t)
            moved = np.abs(seen.position - log.position[rows])
            sent = np.abs(seen.command - log.command[rows])
            changed = (moved > 0.5 * log.step) & (moved > 2e-6 * (log.family != "emps"))
            parts = {e["component"] for e in answer["effects"]}
            if all(e["strength"] > 2 for e in answer["effects"]):
                assert changed.any() or (sent > 2e-6).any(), answer
            for j, joint in enumerate(log.joints):
                assert parts & {joint, "link"} or not changed[:, j].any()
            windows = answer["windows_s"].get(name)
            if windows:
                ((start, stop),) = windows
                when = seen.t[changed.any(axis=1)]
                assert start <= when[0] and when[-1] <= stop
                kept = np.sum((seen.t >= start) & (seen.t <= stop))
                assert when.size <= kept
                exact = {"horn_slip", "sensor_spikes"} & {e["effect"] for e in answer["effects"]}
                if exact and not answer["clock_disturbed"]:
                    assert (when[0], when[-1]) == (start, stop)


def test_truth_is_exact(code, logs):
    log, rng = logs["xl330_kp800_sin_time_square"], np.random.default_rng(0)
    t, command, angle = log.t, log.command[:, 0], log.position[:, 0]

    def put(name, p):
        return code["real_effects"].EFFECTS[name].put(log, 0, p, rng)

    assert np.abs(put("sensor_gain", {"gain": 1.1}).position[:, 0] - 1.1 * angle).max() < 1e-12
    coarse = put("encoder_quantization", {"step_rad": 5 * log.step}).position[:, 0]
    assert np.abs(coarse / (5 * log.step) - np.round(coarse / (5 * log.step))).max() < 1e-6
    late = put("clock_drift", {"s_per_s": 0.01}).position[:, 0]
    assert np.abs(np.interp(t * 1.01, t, late) - angle)[t < 5.9].max() < 10 * log.step

    sent = put("command_filter", {"time_constant_s": 0.03}).command[:, 0]
    state, means = command[0], []
    for k, dt in enumerate(np.diff(t)):
        fade = np.exp(-dt / 0.03)
        means.append(sent[k] + (state - sent[k]) * 0.03 / dt * (1 - fade))
        state = sent[k] + (state - sent[k]) * fade
    assert np.abs(np.array(means) - command[:-1]).max() < 2e-3
    assert np.abs(sent - command).max() > 0.05

    slow, fine = put("sensor_filter", {"time_constant_s": 0.02}).position[:, 0], []
    state = angle[0]
    for k, dt in enumerate(np.diff(t)):
        for share in (np.arange(50) + 0.5) / 50:
            now = angle[k] + share * (angle[k + 1] - angle[k])
            state += (now - state) * (1 - np.exp(-dt / 50 / 0.02))
        fine.append(state)
    assert np.abs(slow[1:] - fine).max() < 1e-4
    assert np.abs(log.fine().position - log.position).max() < 0.5 * log.step
    np.testing.assert_allclose(log.fine().rounded().position, log.position, atol=1e-6)


def test_the_bank_is_in_no_case(sets):
    for _, answer in sets[0]:
        assert not any(name.startswith("single_") for name in answer["background"].values())
        assert "lift_and_drop" not in answer["background"]["a"]
