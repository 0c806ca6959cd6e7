"""Swims that tell rival sets of effects apart: within limits and pool, and better than others."""

import json
from dataclasses import replace

import numpy as np
import pytest
from good_input import message, refused
from rival_swims import FISH, POOL, SERVOS, swim_rivals, swim_set
from violations import violations

from sim.fluid.fluid import POOL_M
from sim.inference.design_swim import SwimLimits, SwimObjective, design_swim, draw
from sim.inference.swims import with_values
from sim.twin.twin import Twin
from sim2real.cli import main
from sim2real.design.limits import limits_of
from sim2real.design.rivals import Request
from sim2real.diagnose.rival_sets import read_diagnosis, read_swim_rivals
from sim2real.recording import read_commands

RIVALS = swim_rivals()
LIMITS = SwimLimits([limits_of(FISH, joint.name) for joint in FISH.joints])
SECONDS = 7.0
ASKED = Request(SECONDS, file="d.json")
FEW = {"drawn": 6, "rounds": 1, "threads": 1}


def objective(rivals=RIVALS, **given):
    return SwimObjective(rivals, SERVOS, FISH, LIMITS, threads=1, **given)


@pytest.fixture(scope="module")
def designed():
    return design_swim(RIVALS, SERVOS, FISH, ASKED, **FEW)


def broken(commands):
    """Limits that each joint's commands (N, T, J) break."""
    return [violations(commands[:, :, k], joint) for k, joint in enumerate(LIMITS.joints)]


def test_random_swims_keep_the_limits_of_every_joint_and_begin_and_end_at_rest():
    commands = draw(np.random.default_rng(0), 12, LIMITS, SECONDS)
    assert broken(commands) == [[[]] * 12] * 3
    np.testing.assert_array_equal(LIMITS.within(commands), commands)
    moved = np.ptp(commands, axis=1)
    assert (moved > 0.1).any(axis=0).all()
    assert len(np.unique(moved[:, 2])) > 6


def test_the_swim_stays_in_the_pool_and_keeps_all_limits(designed):
    (body,) = designed.joints
    assert broken(body.command[None]) == [[[]]] * 3
    assert np.ptp(body.command, axis=0).max() > 0.1
    model = with_values(SERVOS, dict(RIVALS.sets[0].coordinates))
    (track,) = Twin(FISH, model, threads=1).swum(body.command, np.zeros(3))
    length = sum(link.length_m for link in FISH.links)
    assert np.abs(track[:, :2]).max() < POOL_M[0] / 2 - length + 0.02


def test_a_path_through_a_wall_counts_against_a_swim():
    t = LIMITS.joints[0].times(30.0)[:, None]
    straight = LIMITS.within((0.5 * np.sin(2 * np.pi * 1.2 * t - 1.2 * np.arange(3)))[None])
    still = np.zeros_like(straight)
    one = objective()
    over = one.excesses(np.concatenate([straight, still]))["walls of the pool"]
    assert over[0] > 0.2
    assert over[1] == 0.0
    scores = one(np.concatenate([straight, still]))
    assert scores[0] < scores[1] - over[0]


def test_a_designed_swim_tells_more_than_a_random_one(designed):
    (body,) = designed.joints
    random = objective()(draw(np.random.default_rng(9), 4, LIMITS, SECONDS))
    assert -body.remaining > np.median(random)
    assert body.remaining < body.entropy


def test_what_is_alike_or_imitated_by_the_error_of_the_twin_is_told_apart_less():
    same = replace(RIVALS, sets=(RIVALS.sets[0], replace(RIVALS.sets[0], probability=0.4)))
    wide = swim_rivals({name: 20 * sd for name, sd in RIVALS.imitation.items()})
    command = draw(np.random.default_rng(1), 1, LIMITS, SECONDS)
    alike, apart, imitated = (
        objective(one).distances(command)[0, 0, 1] for one in (same, RIVALS, wide)
    )
    assert alike == pytest.approx(0.0, abs=1e-6)
    assert apart > 0.1
    assert imitated < 0.5 * apart


@pytest.fixture
def files(tmp_path, monkeypatch):
    for name in ("robot.toml", "model.json"):
        (tmp_path / name).write_text((POOL / name).read_text())
    monkeypatch.chdir(tmp_path)
    write(tmp_path, RIVALS.content())
    return tmp_path


def write(folder, rivals):
    content = {"schema": "sim2real.diagnosis/1", "rival_sets": [], "model": "model.json"}
    (folder / "diagnosis.json").write_text(json.dumps(content | {"swim_rivals": rivals}))


def test_rivals_of_swims_survive_a_file(files):
    again = read_swim_rivals(read_diagnosis("diagnosis.json"))
    assert again.content() == RIVALS.content()


def design(*more):
    given = ["--robot", "robot.toml", "--diagnosis", "diagnosis.json", "--out", "next.csv"]
    return main(["design", *given, "--seconds", "5", *more])


def test_the_command_writes_a_swim_and_what_it_is_to_tell(files, capsys, monkeypatch):
    defaults = design_swim.__kwdefaults__
    monkeypatch.setitem(defaults, "drawn", 4)
    monkeypatch.setitem(defaults, "rounds", 1)
    assert design() == 0
    shown = capsys.readouterr().out
    assert "start: at rest in the middle of the pool" in shown
    assert "body: separate" in shown
    assert read_commands(files / "next.csv").command.shape == (250, 3)
    stated = json.loads((files / "next.json").read_text())
    assert stated["kind"] == "pool"
    (body,) = stated["rivals"]
    assert body["component"] == "body"
    assert 0 < body["entropy_after_nats"] < body["entropy_before_nats"]
    assert "drag" in (files / "next.html").read_text()


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        (lambda r: r | {"sets": r["sets"][:1]}, ("diagnosis.json", "leaves some open")),
        (lambda r: r | {"noise": {}}, ("diagnosis.json", "swim_rivals.noise.pose_sd")),
        (
            lambda r: r | {"noise": r["noise"] | {"joint_sd_rad": [0.1]}},
            ("diagnosis.json", "of 1 joints"),
        ),
    ],
)
def test_a_diagnosis_that_does_not_fit_is_one_line(files, capsys, change, parts):
    write(files, change(RIVALS.content()))
    refused(capsys, design(), *parts)
    assert not (files / "next.csv").exists()


def test_bad_requests_are_one_line():
    unknown = replace(RIVALS, sets=(RIVALS.sets[0], swim_set(0.4, "tether.length", 0.1, 0.1)))
    message(lambda: design_swim(unknown, SERVOS, FISH, ASKED, **FEW), "tether.length")
    message(lambda: design_swim(RIVALS, SERVOS, FISH, Request(1.0), **FEW), "--seconds")
    servo = replace(FISH.joints[0].servo, max_torque_Nm=1e-4, where=("robot.toml", "servos"))
    weak = replace(FISH, joints=tuple(replace(joint, servo=servo) for joint in FISH.joints))
    message(lambda: design_swim(RIVALS, SERVOS, weak, ASKED, **FEW), "max_torque_Nm", "robot.toml")


def test_contexts_of_a_bench_are_refused_for_a_swim(files, capsys):
    (files / "contexts.toml").write_text('[[contexts]]\nname = "softer"\ngain_ratio = 0.2\n')
    status = design("--contexts", "contexts.toml")
    refused(capsys, status, "--contexts with a diagnosis of swims")
