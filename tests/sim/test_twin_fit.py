"""The twin's law fitted to a robot, and the warning where it was not."""

import warnings
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from swimming_robots import FISH, servos

import sim2real as s2r
from sim.inference.coordinates import twin_parameters
from sim.twin import fit
from sim.twin.law import FITTED, is_calibrated
from sim.twin.twin import Twin
from sim2real.cli import main

POOL = Path(__file__).parents[2] / "datasets" / "pool"
SHORT = replace(FISH, links=(*FISH.links[:2], FISH.links[3]), joints=FISH.joints[:2])
MODEL = s2r.Model({joint.name: servos().joints[joint.name] for joint in SHORT.joints})
LAW = replace(FITTED, across=1.0, along=0.2, added_mass=0.8, thrust=0.5, tail=3.0)
NAMES = ("wave 1.5 Hz", "left turn", "sine 0.8 Hz, all joints", *fit.HELD_OUT[:2])


def swims(names=NAMES):
    """Swims of a robot of two joints under a law that takes the place of the fluid."""
    robot, body = fit.hull_alone(SHORT), {"twin": vars(LAW)}
    sent = fit.set_points(robot, names, 2.0)
    track = Twin(robot, replace(MODEL, body=body), n_envs=len(sent)).swim(
        sent, np.arange(len(sent))
    )
    return fit.Swims(robot, MODEL, names, track)


def test_the_fitted_law_swims_as_the_fluid_does_where_that_of_the_fish_does_not(monkeypatch):
    monkeypatch.setattr(fit, "STARTS", (FITTED,))
    monkeypatch.setattr(fit, "HELD_OUT", NAMES[3:])
    found = fit.fit_twin(MODEL, swims(), lambda share: None)
    assert found.fit["twin.surge"]["fish"] > 0.05
    for name in ("surge", "sway", "yaw_rate"):
        assert max(found.fit[f"twin.{name}"].get(part) for part in ("train", "heldout")) < 0.02


def test_the_command_writes_a_law_that_is_warned_of_for_other_robots_only(tmp_path, monkeypatch):
    best = SimpleNamespace(x=np.log([*vars(LAW).values()]), cost=0.0)
    monkeypatch.setattr(fit, "swum", lambda *_, **__: swims(tuple(fit.WAVES)))
    monkeypatch.setattr(fit.Swims, "fitted", lambda *_: best)
    files = [str(POOL / "robot.toml"), "--model", str(POOL / "model.json")]
    assert main(["fit-twin", *files, "--out", str(tmp_path / "fitted.json")]) == 0
    fitted = s2r.read_model(tmp_path / "fitted.json")
    assert np.allclose([*fitted.body["twin"].values()], [*vars(LAW).values()])
    assert not is_calibrated(fitted.body) and "posterior" not in fitted.body
    along = next(p for p in twin_parameters(fitted, SHORT) if p.name == "twin.along")
    assert along.nominal == pytest.approx(LAW.along), "a calibration starts from it"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Twin(SHORT, fitted)
        Twin(SHORT, replace(MODEL, body={"twin": vars(LAW)}))  # calibrated to swims of its own
    for robot, body in ((SHORT, {}), (FISH, fitted.body)):
        with pytest.warns(UserWarning, match="fit-twin"):
            Twin(robot, replace(servos(), body=body))
