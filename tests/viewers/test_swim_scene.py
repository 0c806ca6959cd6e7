"""Swims of a diagnosis for viewers: as recorded, and simulated before and after."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from sim.inference.diagnose_swims import simulator_of
from sim.inference.swims import swim_of
from sim.view.swim_page import swims_scene
from sim2real.diagnose.result import Diagnosis
from sim2real.model import read_model
from sim2real.recording import read_recording
from sim2real.robot import read_robot

POOL = Path(__file__).parents[2] / "datasets" / "pool"


def test_a_diagnosis_shows_the_swims_of_both_models() -> None:
    robot, plain = read_robot(POOL / "robot.toml"), read_model(POOL / "model.json")
    recording = read_recording(POOL / "p1.csv").between(0, 150)
    swim = swim_of(recording, robot)
    slower = {
        name: replace(joint, kp_Nm_per_rad=0.3 * joint.kp_Nm_per_rad)
        for name, joint in plain.joints.items()
    }
    enriched = replace(plain, joints=slower)
    found = Diagnosis("explained", (), (), (), {}, {}, {}, enriched, baseline=plain)
    simulate = simulator_of(robot, plain)
    scene = swims_scene(found, [recording], [swim], simulate, robot)
    assert [track.path for track in scene.tracks] == [
        ("p1", "body", "measured"),
        ("p1", "body", "plain"),
        ("p1", "body", "enriched"),
    ]
    measured, before, after = scene.tracks
    np.testing.assert_array_equal(before.t, recording.t)
    np.testing.assert_allclose(before.points[0, 0], measured.points[0, 0], atol=0.02)
    assert np.abs(before.points - after.points).max() > 0.02
    groups = {group.path: group for group in scene.groups}
    simulated = groups["p1", "j1", "position"].signals
    assert list(simulated) == ["command", "measured", "plain", "enriched"]
    assert np.ptp(simulated["enriched"]) < np.ptp(simulated["plain"])
    alone = swims_scene(found, [recording], [swim], None, robot)
    assert len(alone.tracks) == 1
