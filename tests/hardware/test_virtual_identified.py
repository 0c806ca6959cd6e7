"""From a port to fitted gains: what is recorded is what the servo did, through loss and noise."""

import numpy as np
import pytest
from virtual_bench import IDENTIFIED, PORTS, SECONDS

from sim2real.identification.identify import identify
from sim2real.recording import read_recording
from sim2real.robot import read_robot


@pytest.mark.parametrize("kind", PORTS)
def test_identify_finds_the_virtual_servo(recorded, kind):
    folder, _, statuses = recorded
    assert statuses[kind] == 0
    robot = read_robot(folder / "robot.toml")
    recordings = [read_recording(folder / f"{kind}.csv")]
    model = identify(recordings, robot, law="pd").joints["j1"]  # what the virtual servo obeys
    assert model.kp_Nm_per_rad == pytest.approx(IDENTIFIED["kp"], rel=0.03)
    assert model.kd_Nms_per_rad == pytest.approx(IDENTIFIED["kd"], rel=0.03)
    assert model.latency_s == pytest.approx(IDENTIFIED["latency"], abs=0.003)


@pytest.mark.parametrize("kind", PORTS)
def test_what_is_written(recorded, kind):
    folder, said, _ = recorded
    recording = read_recording(folder / f"{kind}.csv")
    rows = recording.t.size
    missing = int(np.isnan(recording.position).sum())
    assert f"{rows} rows" in said[kind]
    assert f"j1 {missing}" in said[kind]
    assert 5 < missing < 0.4 * rows, "two per cent of packets each way, and noise"
    assert recording.t[-1] == pytest.approx(SECONDS, abs=0.1), "its schedule does not drift"
    assert np.ptp(recording.command) > 0.5
    assert recording.loads["j1"].inertia_kgm2 == IDENTIFIED["inertia"]
    supply, temperature = (recording.columns[c] for c in ("supply_V", "j1.temperature_C"))
    assert np.nanmin(supply) == np.nanmax(supply) == 7.4
    assert np.nanmin(temperature) == np.nanmax(temperature) == 30
    assert np.isfinite(supply).sum() > 0.3 * rows
    clock = recording.columns["device_t_s"]
    if kind == "udp":
        told = np.isfinite(clock)
        assert told.sum() > 0.6 * rows
        apart = np.diff(clock[told]) - np.diff(recording.t[told])
        assert np.abs(np.median(apart)) < 1e-3
    else:
        assert np.isnan(clock).all()
