"""The recordings that ship: made by their program, true to their truth, unknown to the library."""

import ast
import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "datasets" / "servo_steps"
NAMES = ("steps", "sine", "square", "chirp")
JOINTS = ("j1", "j2", "j3")


@pytest.fixture(scope="module")
def make():
    spec = importlib.util.spec_from_file_location("servo_steps_make", FOLDER / "make.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up by name
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]


def test_the_program_makes_the_committed_files_again(make, tmp_path):
    make.main(["--out", str(tmp_path)])
    made = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert set(made) == {f"{n}.{e}" for n in NAMES for e in ("csv", "json")} | {"truth.json"}
    assert made == {name: (FOLDER / name).read_bytes() for name in made}


@pytest.mark.parametrize("joint", JOINTS)
def test_the_closed_form_agrees_with_numerical_integration(make, joint):
    rng = np.random.default_rng(3)
    sent = np.cumsum(rng.uniform(0.01, 0.03, size=60))
    command = rng.uniform(-0.6, 0.6, size=60)
    t = np.sort(rng.uniform(sent[0], sent[-1], size=200))
    servo = make.SERVOS[joint]

    def motion(_, state, target):
        position, velocity = state
        torque = servo.kp_Nm_per_rad * (target - position) - servo.kd_Nms_per_rad * velocity
        line = -servo.stall_torque_Nm / servo.no_load_speed_rad_s * velocity
        torque = np.clip(torque, line - servo.stall_torque_Nm, line + servo.stall_torque_Nm)
        return velocity, torque / servo.inertia_kgm2

    # One command after the other, so that the integrator meets no jump inside a piece.
    edges = np.concatenate([[sent[0]], sent + servo.latency_s])
    targets = np.concatenate([command[:1], command])
    state, pieces = np.array([command[0], 0.0]), []
    for start, stop, target in zip(edges[:-1], edges[1:], targets[:-1], strict=True):
        piece = solve_ivp(
            motion,
            (start, stop),
            state,
            "LSODA",
            np.append(t[(t >= start) & (t < stop)], stop),
            args=(target,),
            rtol=1e-11,
            atol=1e-12,
            max_step=2e-4,
        ).y
        pieces.append(piece[:, :-1])
        state = piece[:, -1]
    expected = np.concatenate(pieces, axis=1).T
    found = make.simulate(servo, t, sent, command)
    np.testing.assert_allclose(found[:, 0], expected[:, 0], rtol=0, atol=1e-6)
    np.testing.assert_allclose(found[:, 1], expected[:, 1], rtol=0, atol=1e-5)


def test_no_library_code_knows_the_truth():
    files = [
        path
        for package in ("sim2real", "sim", "rl")
        for path in (ROOT / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    ]
    assert files
    assert [str(path) for path in files if b"truth.json" in path.read_bytes()] == []


def test_the_program_imports_nothing_from_the_library():
    imported = set()
    for node in ast.walk(ast.parse((FOLDER / "make.py").read_text())):
        if isinstance(node, ast.Import):
            imported |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0
            imported.add(node.module.split(".")[0])
    assert imported <= set(sys.stdlib_module_names) | {"numpy"}
