"""The servo as a function of CasADi: as ``predict`` on recordings, in parts and as C."""

import subprocess
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from exported import TYPICAL, servo

import sim2real as s2r
from sim2real.cli import main
from sim2real.exporters.actuator import actuators
from sim2real.exporters.casadi_function import HAS, servo_function
from sim2real.recording import Load
from sim2real.servo.parameters import joint_row
from sim2real.servo.prediction import predict
from sim2real.servo.rollout import rollout

LINE = {"stall_torque_Nm": 1.6, "no_load_speed_rad_s": 5.2}
LOSSES = LINE | {
    "resistance_rise": 1.0, "motor_friction": 0.2, "load_friction": 0.1,
    "stribeck_motor_friction": 0.1, "stribeck_speed_rad_s": 0.5,
}  # fmt: skip
SOFT = LINE | {"coulomb_Nm": 0.05, "stick_time_s": 0.01, "creep_time_s": 0.001}
SERVOS = {
    **{name: servo(**{name: TYPICAL[name]}) for name in HAS if not name.startswith("motor.")},
    "losses": servo(Load(0.003, 0.3, 0.1), LOSSES),
    "soft": servo(motor=SOFT),
    "current": servo(motor=LINE, torque_saturation={"limit_Nm": 0.4, "free_damping": 0.0}),
}


def angles(function, t, command, latency):
    """Angles at ``t`` (T,) of a servo that starts at rest on its first set-point."""
    events = np.unique(np.r_[t, t + latency])
    ends = np.unique(np.r_[events, np.arange(t[0], t[-1], 0.009)])  # none longer than 10 ms
    ends = ends[ends <= t[-1]]
    sent = command[np.maximum(np.searchsorted(t + latency, ends[:-1], "right") - 1, 0)]
    start = np.full(function.size1_in(0), command[0])
    start[1] = 0.0
    given = [function.default_in(k) for k in range(3, function.n_in())]
    states = function.mapaccum(ends.size - 1)(start, sent[None], np.diff(ends)[None], *given)
    return np.r_[command[0], np.asarray(states)[0]][np.searchsorted(ends, t)]


@pytest.mark.parametrize("name", SERVOS)
def test_moves_as_predicted(name):
    """As a prediction in short steps, within 0.1 mrad: in the usual ones it is not more exact."""
    model = SERVOS[name]
    (actuator,), row = actuators(model), joint_row(model.joints["j1"], None)[None]
    t = 0.02 * np.arange(150) + np.random.default_rng(3).uniform(0, 0.002, 150)
    levels = np.random.default_rng(4).uniform(-0.6, 0.6, 6)
    for command in (np.repeat(np.r_[0.0, levels], 25)[:150], 0.5 * np.sin(4 * (t - t[0]))):
        expected = rollout(row, t, command, steps_per_radian=300.0)[0]
        found = angles(servo_function(actuator), t, command, actuator.latency)
        assert np.abs(found - expected).max() < 1e-4


def test_files_of_a_servo_of_the_shipped_recordings(tmp_path):
    """Identified, exported, loaded and compiled: within 0.1 mrad on every recording."""
    folder = Path("datasets/servo_steps")
    recordings = [s2r.read_recording(folder / f"{n}.csv") for n in ("steps", "square", "chirp")]
    model = s2r.identify(recordings[:2], folder / "robot.toml")
    s2r.write_model(model, tmp_path / "model.json")
    out = tmp_path / "servo.casadi"
    call = ["export-servo", str(tmp_path / "model.json"), "--to", "casadi", "--out"]
    assert main([*call, str(out)]) == 0
    assert main([*call, str(tmp_path / "servo.c")]) == 2
    file, compiled = ca.FileDeserializer(str(out)), tmp_path / "servo.so"
    source = str(out.with_suffix(".c"))
    subprocess.run(["cc", "-shared", "-fPIC", source, "-o", str(compiled)], check=True)
    for j, (name, joint) in enumerate(model.joints.items()):
        function = file.unpack()
        assert function.name() == f"servo_{name}"
        for recording in recordings:
            t, sent = recording.t, recording.command[:, j]
            expected = predict(model, t, {name: sent}, recording.loads)[name]
            assert np.abs(angles(function, t, sent, joint.latency_s) - expected).max() < 1e-4
        given = {"state": [0.1, 2.0], "set_point": 0.4, "duration_s": 0.008}
        in_c = ca.external(function.name(), str(compiled))
        for made in (function, function.jacobian()):
            external = in_c if made is function else in_c.jacobian()
            for ours, theirs in zip(
                made(**given).values(), external(**given).values(), strict=True
            ):
                np.testing.assert_allclose(np.asarray(theirs), np.asarray(ours), rtol=1e-9)
