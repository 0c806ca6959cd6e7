"""Statements about effects: words that follow the numbers, units, sane rounding."""

import re

import numpy as np
import pytest
from test_effects import SQUARE, STEP, T, each, simulate

from sim2real.diagnose.screening import candidate
from sim2real.effects import BODY, CAMERA, CATALOGUE, named
from sim2real.units import readable

NUMBER = re.compile(r"(-?\d+(?:\.\d+)?(?:e[+-]\d+)?)\s?([^\s,]*)")
UNITS = ("°", "%", "ms", "ppm", "N", "mN", "kg", "rad/s", "rad/s²")
DRAWS = 200


def drawn(effect, rng):
    """Values over the whole range, small ones as often as large ones, of either sign if allowed."""
    values = {}
    for p in effect.parameters:
        least = p.low if p.low > 0 else 1e-4 * p.high
        size = np.exp(rng.uniform(np.log(least), np.log(p.high)))
        sign = rng.choice([-1.0, 1.0]) if p.low < 0 else 1.0
        values[p.name] = float(np.clip(sign * size, p.low, p.high))
    return values


@each()
def test_every_number_is_that_of_a_parameter_is_rounded_and_has_a_unit(effect):
    rng = np.random.default_rng(0)
    for _ in range(DRAWS):
        values = drawn(effect, rng)
        text = effect.statement(values)
        assert not re.search(r"nan|inf\b|[{}]", text), text
        told = text.replace(" 0°", "")
        found = re.findall(r"-?\d[\d.]*(?:e[+-]\d+)?", told)
        assert found, "a statement says how large the effect is"
        for number in found:
            assert float(number) > 0, f"zero or a sign that the words should tell: {text}"
            digits = number.partition("e")[0].replace(".", "").strip("0")
            assert len(digits) <= 3, text
        assert all(unit.startswith(UNITS) for _, unit in NUMBER.findall(told)), text
        sizes = {readable(name, abs(x)) for name, x in values.items()}
        said = [size for size in sizes if size in text]
        assert len(said) >= len(re.findall(r"\d[\d.]*", told)) * 0.5, text
        first = effect.parameters[0].name
        assert readable(first, abs(values[first])) in text


DIRECTED = [e for e in CATALOGUE if any(p.low < 0 and "phase" not in p.name for p in e.parameters)]


@pytest.mark.parametrize("effect", DIRECTED, ids=lambda effect: effect.name)
def test_opposite_signs_have_opposite_words_and_the_same_numbers(effect):
    rng = np.random.default_rng(2)
    (signed,) = [p.name for p in effect.parameters if p.low < 0]
    for _ in range(DRAWS):
        values = drawn(effect, rng)
        mirrored = values | {signed: -values[signed]}
        one, other = effect.statement(values), effect.statement(mirrored)
        assert one != other
        assert NUMBER.findall(one) == NUMBER.findall(other)


RAMP = np.clip(0.5 * (T - 0.2), 0, None)
"""On which a later set-point is a smaller angle."""
SOON = 28  # after a step up: the lower the angle, the slower
WORDS = {  # effect: values, command, sample, words where it is larger than the plain servo's
    "sensor_gain": ({"gain": 0.1}, STEP, -1, ("large", "small")),
    "sensor_offset": ({"offset_rad": 0.05}, STEP, -1, ("high", "low")),
    "gravity_load": ({"torque_Nm": 0.1}, STEP, -1, ("away", "towards")),
    "unmodelled_inertia": ({"inertia_kgm2": 0.001}, STEP, SOON, ("large", "small")),
    "clock_drift": ({"s_per_s": 0.005}, RAMP, -1, ("shrinks", "grows")),
}


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("name", list(WORDS))
def test_words_of_direction_agree_with_the_simulation(name, sign):
    values, command, at, (larger, smaller) = WORDS[name]
    values = {key: sign * value for key, value in values.items()}
    more = simulate(command, **{name: values})[at] > simulate(command)[at]
    text = named(name).statement(values)
    assert re.search(rf"\b{larger if more else smaller}\b", text), text
    assert not re.search(rf"\b{smaller if more else larger}\b", text), text


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_stronger_direction_of_the_motor_is_the_one_that_is_said(sign):
    asymmetry = {"asymmetry": 0.4 * sign}
    speed = np.gradient(simulate(SQUARE, torque_asymmetry=asymmetry), T)
    faster = "positive" if speed.max() > -speed.min() else "negative"
    text = named("torque_asymmetry").statement(asymmetry)
    assert f"larger in the {faster} direction" in text
    rubs = {"torque_Nm": 0.3, "asymmetry": 0.5 * sign}
    angle = simulate(SQUARE, asymmetric_friction=rubs)
    # It stops farther from the command where friction is larger.
    at_top, at_bottom = 0.5 - angle.max(), 0.5 + angle.min()
    larger = "positive" if at_top > at_bottom else "negative"
    text = named("asymmetric_friction").statement(rubs)
    assert f"larger than that in the {larger} direction" in text


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_supply_that_falls_weakens_the_motor(sign):
    droop = {"loss_per_min": 0.4 * sign}
    weight = {"gravity_load": {"torque_Nm": 0.5}}
    more = simulate(supply_droop=droop, **weight)[-1] > simulate(**weight)[-1]
    assert ("rises" if more else "falls") in named("supply_droop").statement(droop)


def test_friction_falls_only_where_the_numbers_do_and_fits_start_there():
    effect, rng = named("stribeck_friction"), np.random.default_rng(3)
    for _ in range(DRAWS):
        values = drawn(effect, rng)
        text = effect.statement(values)
        assert ("falls" in text) == (values["breakaway_Nm"] > values["torque_Nm"])
    text = effect.statement({"torque_Nm": 0.00358, "breakaway_Nm": 0.000258, "velocity_rad_s": 0.3})
    assert text == "Coulomb friction of 3.58 mN m acts on the shaft"
    starts = candidate(effect, 2.0, 0.002).starts
    assert np.all(starts[:, 1] > starts[:, 0])


def test_torque_per_inertia_has_its_unit():
    said = named("coulomb_friction").statement({"torque_Nm": 12.0}, per_inertia=True)
    assert "12 N m/(kg m²)" in said


@pytest.mark.parametrize("effect", [*BODY, *CAMERA], ids=lambda effect: effect.name)
def test_titles_leave_the_direction_to_the_sign(effect):
    """The size follows the title: ``change of the form drag, ...: coefficient -0.1``."""
    assert effect.title and not re.search(r"[.{}_]", effect.title)
    if any(p.low < 0 for p in effect.parameters):
        directed = r"\b(more|less|larger|smaller|faster|slower|rougher|late|early|too|gain|loss)\b"
        assert not re.search(directed, effect.title), effect.title
