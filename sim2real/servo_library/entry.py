"""One servo of the library: a model of one joint, and where it comes from.

An entry is a model file whose ``provenance.servo`` states what a user has to know of it::

    "servo": {"name": "xl330_gain800", "type": "Dynamixel XL330-M288-T", "origin": "identified",
              "source": "recordings by ...", "licence": "Apache-2.0", "date": "2026-01-15",
              "supply_V": 7.4, "firmware_gain": 800, "scored_on": "each trajectory in turn ..."}
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import date
from typing import TYPE_CHECKING, Any, Literal, get_args

from sim2real.display import NotebookDisplay, from_report
from sim2real.errors import InputError, names_of, shown
from sim2real.model import JointModel, Model, read_model
from sim2real.structured import Fields

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Origin = Literal["identified", "published"]
ORIGINS: tuple[Origin, ...] = get_args(Origin)
JOINT = "j1"
"""Name of the joint in the file of an entry."""
NAME = re.compile(r"[a-z0-9][a-z0-9_]*")
TEXTS = ("name", "type", "origin", "source", "licence", "date")


@dataclass(frozen=True)
class ServoEntry(NotebookDisplay):
    """A servo of the library.

    Attributes:
        name: Its name in the library.
        type: Make and type of the servo.
        origin: ``"identified"`` by this library from recordings, or ``"published"`` by others.
        source: Where recordings or parameters come from.
        licence: Licence of the source.
        date: Day or month of the recordings, or of the release that has the parameters (ISO 8601).
        supply_V: Supply voltage, V; None if not known.
        firmware_gain: Proportional gain of the firmware, in its own unit; None if not known.
        scored_on: What the held-out error was measured on; empty if it was not.
        model: The model, of the joint ``j1``.
    """

    name: str
    type: str
    origin: Origin
    source: str
    licence: str
    date: str
    supply_V: float | None
    firmware_gain: float | None
    scored_on: str
    model: Model

    @property
    def joint(self) -> JointModel:
        """The servo."""
        return self.model.joints[JOINT]

    @property
    def held_out_rad(self) -> float | None:
        """RMS error on trajectories that no fit used, rad; None if it was not measured."""
        return self.model.fit.get(f"{JOINT}.position_rad", {}).get("heldout")

    def for_joints(self, joints: Sequence[str] | str = JOINT) -> Model:
        """A model whose joints all have this servo.

        Args:
            joints: Names of the joints.

        Raises:
            InputError: If there is none.
        """
        names = names_of("servos", "joints", joints)
        if not names or not all(names):
            raise InputError("servos", "joints", shown(joints), "names of joints")
        figures = self.model.fit.get(f"{JOINT}.position_rad", {})
        return replace(
            self.model,
            joints=dict.fromkeys(names, self.joint),
            fit={f"{joint}.position_rad": figures for joint in names} if figures else {},
        )

    def plot(self) -> Figure:
        """Stall torque and no-load speed of the servo."""
        figure: Figure = from_report("servo_table.motor_figure")([self])
        return figure


def read_entry(path: str | os.PathLike[str]) -> ServoEntry:
    """Read an entry.

    Raises:
        InputError: If it is no model, or lacks what an entry needs.
    """
    return entry_of(read_model(path), path)


def entry_of(model: Model, file: str | os.PathLike[str]) -> ServoEntry:
    """The entry that a model describes in ``provenance.servo``.

    Args:
        model: A model of one joint.
        file: Its file, for messages.

    Raises:
        InputError: If it lacks what an entry needs.
    """
    fields = Fields(file, "provenance.servo", model.provenance.get("servo", {}))
    _check_joint(model, file)
    texts: dict[str, Any] = {name: fields.text(name) for name in TEXTS}
    for name, text in texts.items():
        if not text.strip():
            raise fields.error(name, "text")
    if not NAME.fullmatch(texts["name"]):
        raise fields.error("name", "small letters, digits and underscores")
    if texts["origin"] not in ORIGINS:
        raise fields.error("origin", f"one of {', '.join(ORIGINS)}")
    if not _is_date(texts["date"]):
        raise fields.error("date", "a day or a month, as 2026-01-31 or 2026-01")
    entry = ServoEntry(
        **texts,
        supply_V=_setting(fields, "supply_V"),
        firmware_gain=_setting(fields, "firmware_gain"),
        scored_on=fields.text("scored_on", ""),
        model=model,
    )
    if entry.origin == "identified":
        _check_identified(entry, file)
    return entry


def _setting(fields: Fields, name: str) -> float | None:
    """A number above 0; None where the file says null, which stands for not known."""
    if name in fields and fields.content[name] is None:
        return None
    if name not in fields:
        raise fields.error(name, "a number above 0, or null if it is not known")
    return fields.number(name, above=0)


def _is_date(text: str) -> bool:
    day = f"{text}-01" if len(text) == len("2026-01") else text
    try:
        return date.fromisoformat(day).isoformat() == day
    except ValueError:
        return False


def _check_joint(model: Model, file: str | os.PathLike[str]) -> None:
    """Check that there is one joint, and that its law and its effects are known."""
    from sim2real.servo.parameters import joint_row

    if list(model.joints) != [JOINT]:
        found = ", ".join(model.joints) or "none"
        raise InputError(
            file, "joints", found, f"one joint, {JOINT} (servos add --joint chooses it)"
        )
    joint = model.joints[JOINT]
    if joint.load is None and not joint.per_inertia:
        expected = "the load that it was identified with, or per_inertia"
        raise InputError(file, f"joints.{JOINT}.load", "nothing", expected)
    joint_row(joint, joint.load, where=str(file))


def _check_identified(entry: ServoEntry, file: str | os.PathLike[str]) -> None:
    """Check that an identified servo has intervals and an error on data that no fit used."""
    error = entry.held_out_rad
    if error is None:
        expected = "an error on data that the fit did not use"
        raise InputError(file, f"fit.{JOINT}.position_rad.heldout", "nothing", expected)
    if not entry.scored_on:
        expected = "the data that the held-out error was measured on"
        raise InputError(file, "provenance.servo.scored_on", "nothing", expected)
    for name in ("kp_Nm_per_rad", "kd_Nms_per_rad", "latency_s"):
        if name not in entry.joint.interval:
            raise InputError(file, f"joints.{JOINT}.interval.{name}", "nothing", "a 90 % interval")
