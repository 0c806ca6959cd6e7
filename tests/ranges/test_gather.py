"""Ranges from recordings made by the paper's own table, and from a bench."""

from dataclasses import replace

import numpy as np
import pytest
import simulated

from sim2real.errors import InputError
from sim2real.model import FittedEffect, JointModel, Model
from sim2real.ranges.gather import Sampling, gather
from sim2real.recording import Load
from sim2real.robot import Joint, Link, Robot, Servo

LINK = Link("head", 0.5, 0.2, 0.1, 0.1, mass_sd_kg=0.01)
ROBOT = Robot(
    "one", (LINK, replace(LINK, name="tail")), (Joint("j1", Servo("s", 1, 5, 0.0), (-1, 1)),)
)
JOINT = JointModel(
    simulated.KP, simulated.KD, simulated.LATENCY, simulated.INERTIA, load=Load(simulated.INERTIA)
)
SAMPLING = Sampling(steps=300, walkers=16)


@pytest.fixture(scope="module")
def bench():
    return [simulated.recording(k, f"r{k}") for k in range(3)]


@pytest.fixture(scope="module")
def found(bench):
    return gather(bench, ROBOT, Model({"j1": JOINT}), SAMPLING)


def test_the_papers_table_comes_back(paper, monkeypatch):
    monkeypatch.setattr(paper, "SECONDS", 15.0)
    recordings, latency = paper.episodes(np.random.default_rng(2))
    ratios = paper.compared(gather(recordings, paper.ROBOT, paper.MODEL).ranges)
    assert len(ratios) == 7
    assert np.ptp(latency) == pytest.approx(0.040, rel=0.05)  # these draws are no freak
    for name, ratio in ratios.items():
        assert ratio == pytest.approx(1.0, abs=0.1), name


def test_gains_lie_between_quantiles_of_the_posterior(found):
    kp = found.ranges.named("j1.kp_Nm_per_rad")
    low, high = np.quantile(found.posteriors["j1"].values[:, 0], [0.05, 0.95])
    assert (kp.first, kp.second) == pytest.approx((low, high))
    assert kp.first < 1.01 * simulated.KP and kp.second > 0.99 * simulated.KP
    assert "r0, r1: 5 % and 95 % quantiles" in kp.source and kp.period == "episode"


def test_what_is_held_out_is_not_sampled(bench, found):
    assert [t.name for t in found.posteriors["j1"].data.traces] == ["r0", "r1"]
    assert found.checks["j1"].recording == "r2" and found.checks["j1"].holds
    other = gather(bench, ROBOT, Model({"j1": JOINT}), replace(SAMPLING, held_out="r0"))
    assert other.checks["j1"].recording == "r0"


def test_a_bench_needs_no_links(bench, found):
    bare = Robot("one", (Link("a"), Link("b")), (Joint("j1", Servo("s")),))
    again = gather(bench, bare, Model({"j1": JOINT}), SAMPLING)
    assert again.density is None
    kept = [e for e in found.ranges.entries if "density" not in e.parameter]
    assert list(again.ranges.entries) == kept


def test_density_has_a_range_where_scales_have_errors(found):
    head = found.ranges.named("body.normalised_density.head")
    assert head.first == pytest.approx(1.0) and head.second == pytest.approx(0.01 * np.sqrt(2))


def test_a_pool_alone_takes_gains_from_the_model(bench):
    swum = [replace(r, kind="pool", loads={}) for r in bench]
    joint = replace(JOINT, interval={"kp_Nm_per_rad": (2.1, 2.3), "kd_Nms_per_rad": (0.05, np.inf)})
    body = {
        "effects": [{"effect": "form_drag", "parameters": {"coefficient": 0.3}}],
        "interval": {"form_drag.coefficient": [0.2, 0.5]},
    }
    ranges = gather(swum, ROBOT, Model({"j1": joint}, body)).ranges
    kp, kd = (ranges.named(f"j1.{n}") for n in ("kp_Nm_per_rad", "kd_Nms_per_rad"))
    drag = ranges.named("body.form_drag.coefficient")
    assert (kp.first, kp.second) == (2.1, 2.3)
    assert (kd.first, kd.second) == (0.05, simulated.KD) and "open end" in kd.source
    assert (drag.first, drag.second) == (0.2, 0.5)
    assert any("gains are those of the model" in note for note in ranges.notes)


def test_every_effect_of_the_model_has_a_range():
    truth = {"coulomb_friction": {"torque_Nm": 0.05}}
    effects = (
        FittedEffect("coulomb_friction", {"torque_Nm": 0.04}),
        FittedEffect("latency_jitter", {"halfwidth_s": 0.005}),
    )
    model = Model(
        {"j1": replace(JOINT, effects=effects)},
        effects=(FittedEffect("voltage_sag", {"loss_at_full_load": 0.2}),),
    )
    ranges = gather([simulated.recording(**truth)], ROBOT, model, Sampling(steps=250)).ranges
    friction = ranges.named("j1.coulomb_friction.torque_Nm")
    assert 0.045 < friction.first < friction.second < 0.055 and "posterior" in friction.source
    jitter, sag = (
        ranges.named(n) for n in ("j1.latency_jitter.halfwidth_s", "voltage_sag.loss_at_full_load")
    )
    assert jitter.first == jitter.second == 0.005 and "no interval" in jitter.source
    assert sag.first == 0.2 and sag.unit == ""


def test_missing_physics_is_said():
    loose = [
        simulated.recording(k, f"r{k}", backlash={"gap_rad": 0.06}, noise=5e-4) for k in range(2)
    ]
    notes = gather(loose, ROBOT, Model({"j1": JOINT}), SAMPLING).ranges.notes
    assert any("physics is missing" in note for note in notes)


def test_a_chain_too_short_is_refused(bench):
    with pytest.raises(InputError, match="run again with --steps"):
        gather(bench, ROBOT, Model({"j1": JOINT}), Sampling(steps=20))


def test_what_does_not_fit_together(bench):
    with pytest.raises(InputError, match="each recording once"):
        gather([bench[0], bench[0]], ROBOT, Model({"j1": JOINT}))
    with pytest.raises(InputError, match="a joint not of the robot"):
        gather(bench, ROBOT, Model({"j9": JOINT}))
    with pytest.raises(InputError, match="--held-out: found 'x'"):
        gather(bench, ROBOT, Model({"j1": JOINT}), Sampling(held_out="x"))
