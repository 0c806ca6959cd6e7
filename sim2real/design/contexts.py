"""Contexts of an experiment: what a user can change besides the commands."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

from sim2real.diagnose.rival_sets import JointRivals
from sim2real.errors import InputError
from sim2real.recording import Load, read_load
from sim2real.structured import Fields, read_toml


@dataclass(frozen=True)
class Context:
    """One way to set up the bench."""

    name: str = "as it is"  # what the user calls it
    # loads by joint that replace those of the recordings so far
    loads: Mapping[str, Load] = field(default_factory=dict)
    supply: float = 1.0  # supply voltage, relative to that of the recordings so far
    # proportional gain of the firmware, relative to that of the recordings so far
    gain: float = 1.0

    def load(self, rivals: JointRivals) -> Load:
        """Load of a joint in this context."""
        return self.loads.get(rivals.component, rivals.load)

    @property
    def ratios(self) -> dict[str, float]:
        """The field ``context`` of a recording's JSON."""
        return {"supply_ratio": self.supply, "gain_ratio": self.gain}


AS_IT_IS = Context()
"""The bench of the recordings so far."""


def read_contexts(path: str | os.PathLike[str]) -> tuple[Context, ...]:
    """The contexts of a ``contexts.toml``; InputError if one is not valid."""
    top = Fields(path, "", read_toml(path))
    top.refuse_unknown(["contexts"])
    contexts = tuple(_context(entry) for entry in top.tables("contexts"))
    for name, times in Counter(context.name for context in contexts).most_common(1):
        if times > 1:
            raise InputError(path, "contexts", f"two contexts named {name!r}", "one of each name")
    return contexts


def _context(entry: Fields) -> Context:
    entry.refuse_unknown(["name", "loads", "supply_ratio", "gain_ratio"])
    loads = entry.table("loads")
    found = Context(
        name=entry.text("name"),
        loads={joint: read_load(loads.table(joint)) for joint in loads.content},
        supply=_ratio(entry, "supply_ratio"),
        gain=_ratio(entry, "gain_ratio"),
    )
    if found == Context(found.name):
        expected = "loads, supply_ratio or gain_ratio"
        raise InputError(entry.file, entry.where, "a context that changes nothing", expected)
    return found


def _ratio(entry: Fields, name: str) -> float:
    value = entry.number(name, 1.0, above=0.0)
    if not 1e-3 <= value <= 1e3:
        raise entry.error(name, "a ratio from 0.001 to 1000")
    return value
