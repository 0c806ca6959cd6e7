"""Ranges of what is no servo: density, body, supply and link."""

from __future__ import annotations

from collections.abc import Mapping

from sim2real.body import body_effect, values
from sim2real.density import Density
from sim2real.inference.parameters import unit_of
from sim2real.model import Model
from sim2real.ranges.entry import Range, normal, uniform
from sim2real.structured import finite_number


def density_ranges(density: Density) -> list[Range]:
    """Normalised density of each link, where scale and ruler say how sure they are."""
    if density.sd is None:
        return []
    source = "mass_sd_kg and length_sd_m of the robot's links, through the density's derivatives"
    return [
        normal(f"body.normalised_density.{name}", value, sd, "", source)
        for name, value, sd in zip(density.links, density.value, density.sd, strict=True)
        if sd > 0
    ]


def body_ranges(model: Model) -> list[Range]:
    """Drag and whatever else the model's body was calibrated to, from its 90 % intervals."""
    intervals = model.body.get("interval")
    given: Mapping[str, object] = intervals if isinstance(intervals, Mapping) else {}
    out = []
    for name, value in values(model).items():
        low, high, source = value, value, "the model's body: its value; it gives no interval"
        ends = given.get(name)
        numbers = [finite_number(end) for end in ends] if isinstance(ends, list | tuple) else []
        if len(numbers) == 2:
            low, high = (value if end is None else end for end in numbers)
            source = "the model's body: its 90 % interval"
        out.append(uniform(f"body.{name}", low, high, _body_unit(name), source))
    return out


def shared_ranges(model: Model) -> list[Range]:
    """Effects on the supply and the link that all joints share, as the model has them."""
    source = "the model: its value; it gives no interval"
    return [
        uniform(f"{effect.effect}.{name}", value, value, unit_of(name), source)
        for effect in model.effects
        for name, value in effect.parameters.items()
    ]


def _body_unit(name: str) -> str:
    effect, *_, parameter = name.split(".")
    return next(p.unit for p in body_effect(effect).parameters if p.name == parameter)
