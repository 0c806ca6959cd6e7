"""The servos that ship with the package, by name, and what an entry needs.

An entry is a model file of one joint whose ``provenance.servo`` states what a user has to know::

    "servo": {"name": "xl330_gain800", "type": "Dynamixel XL330-M288-T", "origin": "identified",
              "source": "recordings by ...", "licence": "Apache-2.0", "date": "2026-01-15",
              "supply_V": 7.4, "firmware_gain": 800, "scored_on": "each trajectory in turn ..."}
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

from sim2real.display import NotebookDisplay, from_report
from sim2real.errors import InputError, names_of, one_of, shown
from sim2real.model import JointModel, Model, read_model
from sim2real.structured import Fields

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Origin = Literal["identified", "published"]
JOINT = "j1"
"""Name of the joint in the file of an entry."""
ERROR = f"{JOINT}.position_rad"
"""Name of its error in the model."""


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
        return self.model.fit.get(ERROR, {}).get("heldout")

    def for_joints(self, joints: Sequence[str] | str = JOINT) -> Model:
        """A model whose joints all have this servo.

        Raises:
            InputError: If there is no name of a joint.
        """
        names = names_of("servos", "joints", joints)
        if not names or not all(names):
            raise InputError("servos", "joints", shown(joints), "names of joints")
        figures = self.model.fit.get(ERROR, {})
        return replace(
            self.model,
            joints=dict.fromkeys(names, self.joint),
            fit={f"{joint}.position_rad": figures for joint in names} if figures else {},
        )

    def plot(self) -> Figure:
        """Stall torque and no-load speed of the servo."""
        figure: Figure = from_report("servo_table.motor_figure")([self])
        return figure


def entry_of(model: Model, file: str | os.PathLike[str]) -> ServoEntry:
    """The entry that a model describes; ``InputError``, naming ``file``, if something lacks."""
    fields = Fields(file, "provenance.servo", model.provenance.get("servo", {}))
    _check_joint(model, file)
    names = ("name", "type", "origin", "source", "licence", "date")
    texts: dict[str, Any] = {name: fields.text(name) for name in names}
    for name, text in texts.items():
        if not text.strip():
            raise fields.error(name, "text")
    if not re.fullmatch(r"[a-z0-9][a-z0-9_]*", texts["name"]):
        raise fields.error("name", "small letters, digits and underscores")
    fields.choice("origin", get_args(Origin))
    if not _is_date(texts["date"]):
        raise fields.error("date", "a day or a month, as 2026-01-31 or 2026-01")
    known: dict[str, Any] = {}
    for name in ("supply_V", "firmware_gain"):
        if name not in fields:
            raise fields.error(name, "a number above 0, or null if it is not known")
        unknown = fields.content[name] is None
        known[name] = None if unknown else fields.number(name, above=0)
    entry = ServoEntry(**texts, **known, scored_on=fields.text("scored_on", ""), model=model)
    if entry.origin == "identified":
        _check_identified(entry, file)
    return entry


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
        expected = f"one joint, {JOINT} (servos add --joint chooses it)"
        raise InputError(file, "joints", found, expected)
    joint = model.joints[JOINT]
    if joint.load is None and not joint.per_inertia:
        expected = "the load that it was identified with, or per_inertia"
        raise InputError(file, f"joints.{JOINT}.load", "nothing", expected)
    joint_row(joint, joint.load, where=str(file))


def _check_identified(entry: ServoEntry, file: str | os.PathLike[str]) -> None:
    """Check that an identified servo has intervals and an error on data that no fit used."""
    error, data = "an error on data that the fit did not use", "the data that the held-out error "
    intervals = ("kp_Nm_per_rad", "kd_Nms_per_rad", "latency_s")
    for there, where, expected in (
        (entry.held_out_rad is not None, f"fit.{ERROR}.heldout", error),
        (entry.scored_on, "provenance.servo.scored_on", data + "was measured on"),
        *(
            (name in entry.joint.interval, f"joints.{JOINT}.interval.{name}", "a 90 % interval")
            for name in intervals
        ),
    ):
        if not there:
            raise InputError(file, where, "nothing", expected)


def prepared(
    model: Model,
    about: Mapping[str, Any],
    *,
    joint: str | None = None,
    file: str | os.PathLike[str] = "model",
) -> ServoEntry:
    """An entry from one joint of a model, for a pull request: without paths of this machine.

    Args:
        model: The model.
        about: Fields of ``provenance.servo`` that replace or complete those of the model; None
            stands for a field that is not given.
        joint: Name of the joint; not needed where the model has one.
        file: The model's file, for messages.

    Raises:
        InputError: If the model lacks what an entry needs, or has several joints and none is named.
    """
    names = list(model.joints)
    name = names[0] if joint is None and len(names) == 1 else joint
    if name is None or name not in names:
        expected = f"--joint with one of {', '.join(names)}" if names else "a model with a servo"
        raise InputError(file, "joints", joint or f"{len(names)} joints", expected)
    origin = model.provenance
    known: dict[str, Any] = {"origin": "identified", **origin.get("servo", {})}
    if model.firmware_p_gain is not None:
        known.setdefault("firmware_gain", model.firmware_p_gain)
    known |= {key: value for key, value in about.items() if value is not None}
    held_out, inputs = origin.get("held_out", {}), origin.get("inputs", {})
    if not known.get("scored_on") and isinstance(held_out, Mapping) and held_out.get(name):
        known["scored_on"] = f"{held_out[name]}, which was not fitted"
    kept = {key: origin[key] for key in ("seed", "versions") if key in origin}
    if isinstance(inputs, Mapping) and inputs:
        kept["inputs"] = {Path(str(path)).name: digest for path, digest in inputs.items()}
    figures = model.fit.get(f"{name}.position_rad", {})
    entry = replace(
        model,
        joints={JOINT: _rounded(model.joints[name])},
        body={},
        fit={ERROR: _six_digits(figures)},
        provenance=kept | {"servo": known},
    )
    return entry_of(entry, file)


def _rounded(joint: JointModel) -> JointModel:
    """The joint with six digits, and without the correlations, to be read in a review."""
    names = ("kp_Nm_per_rad", "kd_Nms_per_rad", "latency_s", "motor", "interval")
    effects = tuple(replace(e, parameters=_six_digits(e.parameters)) for e in joint.effects)
    rounded = {name: _six_digits(getattr(joint, name)) for name in names}
    return replace(joint, **rounded, correlation={}, effects=effects)


def _six_digits(value: Any) -> Any:  # noqa: ANN401 - a number or None, several, or a table of them
    if isinstance(value, Mapping):
        return {name: _six_digits(x) for name, x in value.items()}
    if isinstance(value, tuple):
        return tuple(map(_six_digits, value))
    return value if value is None or not math.isfinite(value) else float(f"{value:.6g}")


def at(
    entry: ServoEntry, *, firmware_gain: float | None = None, supply_V: float | None = None
) -> ServoEntry:
    """The servo with another firmware gain or supply; its intervals are scaled likewise.

    The firmware turns the error of the angle into a duty cycle, and the duty cycle times the supply
    is the voltage of the motor: kp is proportional to gain and supply, the stall torque and the
    damping by the controller to the supply, and the back-EMF depends on neither (the circuit of a
    DC motor, any text on motors). ``reports/servo_library.md`` has the error of this on recordings.
    The held-out error is that of the original settings and is omitted where they differ.

    Args:
        entry: The servo.
        firmware_gain: Proportional gain, in the firmware's unit.
        supply_V: Supply voltage, V.

    Raises:
        InputError: If a value is not above 0, the entry's gain is not known, or the supply of a
            servo without a torque-speed line is to be changed.
    """
    name, former = entry.name, (entry.firmware_gain, entry.supply_V)
    gain = _ratio("--firmware-gain", firmware_gain, former[0], name, "firmware gain")
    volts = _ratio("--supply", supply_V, former[1], name, "supply")
    if gain == 1 and volts == 1:
        return entry
    if volts != 1 and not entry.joint.motor.get("no_load_speed_rad_s"):
        found = f"{name}, which has no torque-speed line"
        raise InputError("--supply", "", found, "a servo with the law 'motor'")
    before = {"supply_V": entry.supply_V, "firmware_gain": entry.firmware_gain}
    settings: dict[str, Any] = {
        "supply_V": entry.supply_V and entry.supply_V * volts,
        "firmware_gain": entry.firmware_gain and entry.firmware_gain * gain,
    }
    origin: Mapping[str, Any] = entry.model.provenance
    changed = origin["servo"] | settings | {"scored_on": "", "scaled_from": before}
    joints = {JOINT: _scaled(entry.joint, gain, volts)}
    model = replace(entry.model, joints=joints, fit={}, provenance={**origin, "servo": changed})
    if model.firmware_p_gain is not None:
        model = replace(model, firmware_p_gain=settings["firmware_gain"])
    return replace(entry, **settings, scored_on="", model=model)


def _ratio(option: str, value: float | None, former: float | None, name: str, what: str) -> float:
    if value is None:
        return 1.0
    if former is None:
        found = f"{name}, whose {what} is not known"
        raise InputError(option, "", found, f"a servo with a known {what}")
    if not (math.isfinite(value) and value > 0):
        raise InputError(option, "", f"{value:g}", "a number above 0")
    return value / former


def _scaled(joint: JointModel, gain: float, volts: float) -> JointModel:
    stall = joint.motor.get("stall_torque_Nm", 0.0)
    speed = joint.motor.get("no_load_speed_rad_s", 0.0)
    back_emf = stall / speed if speed else joint.kd_Nms_per_rad
    # What damps more or less than the back-EMF is the controller, whose output is a duty cycle.
    kd = back_emf + volts * (joint.kd_Nms_per_rad - back_emf)
    factors = {
        "kp_Nm_per_rad": gain * volts,
        "kd_Nms_per_rad": kd / joint.kd_Nms_per_rad if joint.kd_Nms_per_rad else 1.0,
        "motor.stall_torque_Nm": volts,
        "motor.no_load_speed_rad_s": volts,
        "motor.resistance_rise": volts,  # stated at the stall torque, which grows with the supply
    }
    interval = {
        name: (low * factors.get(name, 1.0), high * factors.get(name, 1.0))
        for name, (low, high) in joint.interval.items()
    }
    motor = {name: x * factors.get(f"motor.{name}", 1.0) for name, x in joint.motor.items()}
    kp = joint.kp_Nm_per_rad * gain * volts
    return replace(joint, kp_Nm_per_rad=kp, kd_Nms_per_rad=kd, motor=motor, interval=interval)


FOLDER = Path(__file__).parent / "entries"


@dataclass(frozen=True)
class ServoLibrary(NotebookDisplay):
    """Servos of the library; ``servos["xl330_gain800"]`` is one of them.

    Attributes:
        entries: The servos, in alphabetical order.
    """

    entries: tuple[ServoEntry, ...]

    @property
    def names(self) -> list[str]:
        """Their names."""
        return [entry.name for entry in self.entries]

    def __getitem__(self, name: str) -> ServoEntry:
        """The servo with this name.

        Raises:
            InputError: If there is none; the message names the most similar one.
        """
        for entry in self.entries:
            if entry.name == name:
                return entry
        raise InputError("servos", "", repr(name), one_of(name, self.names))

    def __iter__(self) -> Iterator[ServoEntry]:
        return iter(self.entries)

    def __len__(self) -> int:
        return len(self.entries)

    def plot(self) -> Figure:
        """Stall torque and no-load speed of the servos."""
        figure: Figure = from_report("servo_table.motor_figure")(self.entries)
        return figure


def shipped() -> ServoLibrary:
    """All servos of the library.

    Raises:
        InputError: If a file lacks what an entry needs, or is not named after its servo.
    """
    entries = []
    for path in sorted(FOLDER.glob("*.json")):
        entry = entry_of(read_model(path), path)
        if entry.name != path.stem:
            raise InputError(path, "provenance.servo.name", repr(entry.name), f"{path.stem!r}")
        entries.append(entry)
    return ServoLibrary(tuple(entries))
