"""Effects fitted with the gains: known ones come back, and held-out error falls to the noise."""

import pytest
import simulated

from sim2real.effects import named
from sim2real.effects.effect import scaled
from sim2real.identification.identify import identify
from sim2real.robot import Joint, Link, Robot, Servo

NOISE_RAD = 0.001
LINK = Link("link", 0.1, 0.1, 0.1, 0.1)
ROBOT = Robot("bench", (LINK, LINK), (Joint("j1", Servo("s", 9.0, 99.0, 0.0), (-1.0, 1.0)),))


def found(fitted, **effects):
    """The model with effects ``fitted`` of two recordings of a servo that has ``effects``."""
    how = {"noise": NOISE_RAD, **effects}
    given = [simulated.recording(seed, name, **how) for seed, name in enumerate("ab")]
    return identify(given, ROBOT, effects=fitted)


@pytest.mark.parametrize(
    "effects",
    [
        {"coulomb_friction": {"torque_Nm": 0.04}},
        {"torque_saturation": {"limit_Nm": 0.6}},
        {"backlash": {"gap_rad": 0.03, "rotor_inertia_kgm2": 5e-4}},
        {"rate_limit": {"limit_rad_s": 4.0}},
        {"load_friction": {"ratio": 0.2}, "sensor_offset": {"offset_rad": 0.02}},
    ],
    ids=lambda effects: "+".join(effects),
)
def test_a_known_effect_is_recovered_with_the_gains(effects):
    model = found(list(effects), **effects)
    joint, figures = model.joints["j1"], model.fit["j1.position_rad"]
    assert joint.kp_Nm_per_rad == pytest.approx(simulated.KP, rel=0.03)
    assert joint.latency_s == pytest.approx(simulated.LATENCY, abs=0.002)
    for fitted in joint.effects:
        for name, value in effects[fitted.effect].items():
            assert fitted.parameters[name] == pytest.approx(value, rel=0.1)
            low, high = joint.interval[f"{fitted.effect}.{name}"]
            assert low < fitted.parameters[name] < high
    assert figures["heldout"] < 1.15 * NOISE_RAD
    assert figures["heldout_without_effects"] > 1.5 * figures["heldout"]


def test_a_controller_of_the_output_is_found():
    play = {"gap_rad": 0.03, "rotor_inertia_kgm2": 5e-4, "output_friction_Nm": 0.03}
    joint = found(["backlash"], backlash=play | {"control_on_output": 1.0}).joints["j1"]
    assert joint.effects[0].parameters == pytest.approx(play | {"control_on_output": 1.0}, rel=0.1)


def test_an_effect_that_is_not_there_comes_out_as_nothing():
    joint = found(["coulomb_friction"]).joints["j1"]
    assert joint.effects[0].parameters["torque_Nm"] < 0.002
    assert joint.interval["coulomb_friction.torque_Nm"][0] == 0.0
    assert joint.kp_Nm_per_rad == pytest.approx(simulated.KP, rel=0.02)


def test_parameters_scale_with_the_servo():
    torque, inertia, gap = (
        named(effect).parameters[0]
        for effect in ("coulomb_friction", "unmodelled_inertia", "backlash")
    )
    assert scaled(torque, 4.0, 0.002).typical == 2 * torque.typical
    assert scaled(inertia, 4.0, 0.004).typical == 2 * inertia.typical
    assert scaled(gap, 4.0, 0.004) == gap
