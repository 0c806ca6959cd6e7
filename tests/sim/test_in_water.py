"""The twin corrected by the fluid: the fluid where nothing changes, else the twin's difference."""

from dataclasses import replace

import numpy as np
import pytest
from good_input import refused
from swimming_robots import FISH, servos
from test_calibrate import SENT
from test_diagnose_swims import swum

from sim.inference.coordinates import WATER, Coordinates
from sim.inference.in_water import (
    InWater,
    by_twin_in_water,
    key,
    read_water_swims,
    simulate_in_water,
    with_fluid_effects,
    with_nearest_law,
    write_water,
)
from sim.inference.law_error import IN_WATER, learned, read_law_error
from sim.inference.searched import changed, doubtful
from sim.inference.swim_problem import SwimProblem
from sim.inference.swims import by_followed_twin, steps_of, with_values
from sim.robot.swimmer import CONTROL_S
from sim.twin.law import Coefficients
from sim.twin.twin import Twin
from sim2real.body import values
from sim2real.cli import main

KNOWN = read_law_error(IN_WATER)
OTHER = {"twin.across": 2.5, "twin.along": 0.7, "twin.thrust": 0.9}


def speeds(track):
    out = steps_of(track)
    out[..., :3] /= CONTROL_S
    return out


@pytest.fixture(scope="module")
def water():
    """A twin of another law stands for the fluid, a third for its other waters."""
    model = servos()
    laws = [with_values(model, given) for given in (OTHER, OTHER | {"twin.linear": 0.5})]
    first, second = speeds(Twin(FISH, laws, n_envs=2).swum(SENT, np.zeros(3)))
    steps = np.stack([first, second - first, *[0 * first] * (len(WATER) - 1)])
    return InWater(WATER, {key(swum({})): steps})


def test_the_fluid_swims_and_the_twin_adds_what_is_changed(water):
    """Shares of other waters are added in full, an effect changes what it changes of the twin."""
    swim, model = swum({}), water.of(servos())
    other = with_values(model, {"water.cells": 0.5})
    stiff = with_values(model, {"skin_elasticity.stiffness_Nm_per_rad": 0.3})
    same, half, changed = speeds(by_twin_in_water(FISH, model, water)([model, other, stiff], swim))
    alone = speeds(by_followed_twin(FISH)([model, stiff], swim))
    first, way = water.steps[key(swim)][:2]
    np.testing.assert_allclose(same, first, atol=1e-9)
    np.testing.assert_allclose(half, first + 0.5 * way, atol=1e-9)
    np.testing.assert_allclose(changed - same, alone[1] - alone[0], atol=1e-9)


def test_commands_that_the_fluid_has_not_simulated_are_an_error(water):
    model = water.of(servos())
    swim = replace(swum({}), command=1.1 * SENT)
    with pytest.raises(KeyError, match="no simulation of these commands"):
        by_twin_in_water(FISH, model, water)([model], swim)


def test_the_heading_in_which_a_swim_began_counts():
    swim = swum({})
    turned = replace(swim, start=swim.start + [0.3, 0.2, 0.5])
    moved = replace(swim, start=swim.start + [0.3, 0.2, 0.0])
    assert key(swim) == key(moved) != key(turned)


def test_the_fluid_swims_again_with_all_but_places_and_the_camera(water):
    """With these effects the twin then returns the simulation."""
    found = {"skin_elasticity.stiffness_Nm_per_rad": 0.3, "form_drag.coefficient": 0.2}
    other = {"tether.stiffness_N_per_m": 0.1, "camera_scale.ratio": 0.1, "pool_current.u_m_s": 0.1}
    swim, model = swum({}), water.of(servos())
    there = with_fluid_effects(model, with_values(model, found | other | {"twin.across": 9.0}))
    assert values(there) == found
    assert Coefficients.of(there.body) == Coefficients.of(model.body)
    again = replace(water, steps={k: 1.1 * one for k, one in water.steps.items()})
    (track,) = by_twin_in_water(FISH, there, again)([there], swim)
    np.testing.assert_allclose(speeds(track[None])[0], again.steps[key(swim)][0], atol=1e-9)


def test_a_model_with_water_has_a_column_for_each(water):
    kinds = [one.kind for one in Coordinates.of(FISH, water.of(servos())).columns]
    assert [k for k in kinds if k.startswith("water")] == [f"water.{name}" for name in WATER]
    assert not [one for one in Coordinates.of(FISH, servos()).columns if "water" in one.kind]


def test_the_nearest_law_swims_as_the_fluid_did(water):
    near = with_nearest_law(FISH, servos(), water).of(servos())
    found = speeds(Twin(FISH, [servos(), near], n_envs=2).swum(SENT, np.zeros(3)))
    before, after = np.abs(found - water.steps[key(swum({}))][0])[..., :2].mean(axis=(1, 2))
    assert after < 0.4 * before


def in_the(water):
    """One swim as a problem of fits in this water, without references."""
    model = water.of(servos())
    simulate = by_twin_in_water(FISH, model, water)
    before = learned([], model, FISH, simulate, KNOWN)
    return SwimProblem(Coordinates.of(FISH, model), [swum({})], simulate, before)


def test_what_effects_change_is_in_doubt_but_of_the_camera_and_the_current(water):
    problem = in_the(water)
    c, model, (swim,) = problem.coordinates, water.of(servos()), problem.swims

    def change(begun=None, **given):
        x = c.nominal
        for name, value in given.items():
            x[c.place[name.replace("__", ".")]] = value
        (found,) = changed(problem, x, begun)
        return found

    stiff, other = "skin_elasticity__stiffness_Nm_per_rad", "camera_rotation__angle_rad"
    one, two = change(**{stiff: 0.1}), change(**{stiff: 0.2})
    assert 1.6 < np.std(two) / np.std(one) < 2.4
    said = by_twin_in_water(FISH, model, water)(
        [model, with_values(model, {stiff.replace("__", "."): 0.1})], swim
    )[..., 3:]
    np.testing.assert_allclose(one[:, 3:], said[1] - said[0], atol=1e-9)
    assert np.abs(change(**{other: 0.1})).max() < 1e-9
    assert np.abs(change(pool_current__u_m_s=0.03)).max() < 1e-9
    there = with_fluid_effects(model, with_values(model, {stiff.replace("__", "."): 0.1}))
    assert np.abs(change(there, **{stiff: 0.1})).max() < 1e-9
    assert np.std(change(there, **{stiff: 0.2})) < np.std(two)


def test_what_is_wrong_of_a_change_all_along_is_no_evidence(water):
    """A skin whose effect the twin has a tenth too large, late, leaves less for others to say."""
    plain = in_the(water)
    c, (swim,), before = plain.coordinates, plain.swims, plain.prior
    x = c.nominal
    x[c.place["skin_elasticity.stiffness_Nm_per_rad"]] = 1.2
    change = changed(plain, x)
    wrong = replace(swim, signals=swim.signals + 0.1 * change[0] * [0, 0, 0, 1, 1, 1])
    none = frozenset()

    def lost(prior):
        """Evidence that the error takes away."""
        told = [SwimProblem(c, [one], plain.simulate, prior) for one in (swim, wrong)]
        size, at = (one.evidence(none, one.at(one.centre(none))) for one in told)
        return size - at

    assert lost(before) > 3 * lost(doubtful(plain, change)) > 0


def test_what_was_swum_is_kept(water, tmp_path):
    write_water(tmp_path / "deep" / "water.npz", replace(water, law={"across": 2.0}))
    kept = read_water_swims(tmp_path / "deep" / "water.npz")
    assert kept.names == WATER and kept.law == {"across": 2.0}
    (sent,) = kept.steps
    assert sent == key(swum({}))
    np.testing.assert_allclose(kept.steps[sent], water.steps[sent], atol=2e-3)


def test_files_that_are_none_or_of_other_swims_are_told(water, tmp_path, capsys):
    pool, out = "datasets/pool/", tmp_path / "d.json"
    command = ["diagnose", f"{pool}p1.csv", "--robot", f"{pool}robot.toml", "--out", str(out)]
    command += ["--model", f"{pool}model.json", "--in-water"]
    (tmp_path / "text.npz").write_text("t,x\n")
    refused(capsys, main([*command, str(tmp_path / "text.npz")]), "no swims in water")
    write_water(tmp_path / "other.npz", water)
    status = main([*command, str(tmp_path / "other.npz")])
    refused(capsys, status, "no simulation of the commands of")
    assert not out.exists()


def test_the_fluid_swims_all_waters_and_other_cells_differ():
    swim = swum({})
    short = replace(swim, t=swim.t[:30], command=swim.command[:30])
    found = simulate_in_water(FISH, servos(), [short], cell_m=0.04)
    (steps,) = found.steps.values()
    assert steps.shape == (1 + len(WATER), 29, 3 + len(FISH.joints))
    assert np.isfinite(steps).all()
    assert np.abs(steps[1]).max() > 10 * np.abs(steps[3]).max() > 0
