"""The text of an MJCF file with a servo on one of its hinges; all else stays as it is written."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

from sim2real.errors import InputError
from sim2real.exporters.actuator import Export

_TAG = re.compile(r"""<(?:[^>"']|"[^"]*"|'[^']*')*>""")
_FLANK = {"pos": "0 0 0", "mass": "1e-6", "diaginertia": "1e-9 1e-9 1e-9"}
"""The motor's side of a gear train; its tendon has its inertia, which is about the shaft only."""
_NO_LOSSES = {"armature": "0", "damping": "0", "frictionloss": "0"}


@dataclass(frozen=True)
class MjcfHinge:
    """What a compiled file says of a hinge."""

    name: str
    limits: Mapping[str, str]  # attributes of its actuator; empty without one
    armature: float  # to be added to the servo's, kg m2
    behind: Mapping[str, int]  # places in ``qpos`` and ``qvel`` behind the joints of its body
    degrees: bool  # whether angles of the file are
    timestep_s: float


@dataclass
class _Markup:
    """An element of a text: its tags from the root on, attributes and place."""

    path: str
    attrib: dict[str, str]
    start: int
    stop: int  # of its first tag
    end: int


def _parts(text: str) -> list[_Markup]:
    """The elements of a text, each character of which is a byte, in order."""
    found: list[_Markup] = []
    within: list[_Markup] = []
    parser = expat.ParserCreate()

    def start(tag: str, attrib: dict[str, str]) -> None:
        stop = _TAG.match(text, parser.CurrentByteIndex)
        assert stop is not None, tag
        path = f"{within[-1].path}/{tag}" if within else tag
        found.append(_Markup(path, attrib, stop.start(), stop.end(), stop.end()))
        within.append(found[-1])

    def end(_: str) -> None:
        part = within.pop()
        if text.startswith("</", parser.CurrentByteIndex) and text[part.stop - 2] != "/":
            part.end = text.index(">", parser.CurrentByteIndex) + 1

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.Parse(_bytes(text), True)
    return found


def with_servo(file: Path, content: bytes, hinge: MjcfHinge, bench: Export) -> tuple[bytes, str]:
    """The content with the servo of a bench on a hinge, and the name of its actuator.

    ``InputError`` if the hinge or its actuator is in a file that this one includes, or it has a
    servo that was written here.
    """
    text, name, made = content.decode("latin-1"), hinge.name, ElementTree.fromstring(bench.text)
    parts = _parts(text)
    joints = (one for one in parts if re.fullmatch("mujoco/worldbody/.*joint", one.path))
    own = next((one for one in joints if one.attrib.get("name") == name), None)
    targets = {("joint", name), ("jointinparent", name)}
    acting = [x for x in _children(parts, "actuator") if targets & set(x.attrib.items())]
    if own is None or (hinge.limits and not acting):
        where = "a joint or an actuator of an included file"
        raise InputError(file, name, where, "the file that has both")
    title = f"<!-- {name}: identified by sim2real"
    if _raw(title) in text:
        raise InputError(file, name, "a servo that export-servo wrote", "the file from before that")
    shaft, drive = _child(made, "worldbody/body/joint"), _child(made, "actuator/*")
    given = {k: x for k, x in shaft.attrib.items() if k not in {"name", "type", "axis"}}
    limits = dict(hinge.limits) or {"ctrllimited": "false", "forcelimited": "false"}
    if "forcerange" in drive.attrib:
        limits["forcelimited"] = "true"
        given["actuatorfrclimited"] = str("actuatorfrcrange" in given).lower()
    given = _NO_LOSSES | given
    if hinge.armature:
        given["armature"] = f"{hinge.armature + float(given['armature']):.9g}"
    edits = [(own.start, own.stop, _with(text[own.start : own.stop], given))]
    keys = {one.start: one for one in _children(parts, "keyframe")}
    values = {at: dict[str, str]() for at in keys}
    if (motor := made.find("worldbody/body/body")) is not None:
        _finish_motor(motor, own, _child(made, "tendon/fixed"), degrees=hinge.degrees)
        edits.append((own.end, own.end, _xml(motor, text, own.start, before="\n")))
        for at, key in keys.items():
            for kind, place in hinge.behind.items():
                if numbers := key.attrib.get(kind, "").split():
                    values[at][kind] = " ".join([*numbers[:place], "0", *numbers[place:]])
    explicit = {"gear": "1", "actlimited": "false", "delay": "0", "nsample": "0"}
    explicit |= {"dyntype": "none"} if drive.tag == "general" else {}
    drive.attrib = explicit | limits | drive.attrib
    if delay := float(drive.attrib["delay"]):
        drive.set("nsample", str(math.ceil(delay / hinge.timestep_s) + 2))
    lines = "".join(f"\n    {line}".replace("--", "- -") for line in bench.left_out)
    comment = _raw(f"{title}; not expressed:{lines} -->" if lines else f"{title} -->")
    added = {section: made.findall(f"{section}/*") for section in ("tendon", "actuator", "sensor")}
    if acting:
        first, *others = acting
        kept = {"name", "group", "user"}
        drive.attrib |= {k: x for k, x in first.attrib.items() if k in kept}
        indent = _indent(text, first.start)
        edits.append(
            (first.start, first.end, f"{comment}\n{indent}{_xml(drive, text, first.start)}")
        )
        edits += [(one.start, one.end, "") for one in others]
        added["actuator"].remove(drive)
        comment = ""
    else:
        for at, key in keys.items():
            if "ctrl" in key.attrib:
                values[at]["ctrl"] = f"{key.attrib['ctrl']} 0"
    changed = [key for at, key in keys.items() if values[at]]
    edits += [(x.start, x.stop, _with(text[x.start : x.stop], values[x.start])) for x in changed]
    known = {x.attrib.get("name"): x for x in _children(parts, "sensor")}
    for sensor in [one for one in added["sensor"] if one.get("name") in known]:
        old = known[sensor.get("name")]
        edits.append((old.start, old.end, _xml(sensor, text, old.start)))
        added["sensor"].remove(sensor)
    sections = ""
    for section, elements in added.items():
        if elements:
            whole = Element(section)
            whole.extend(elements)
            ElementTree.indent(whole, level=1)
            remark = f"  {comment}\n" if section == "actuator" else ""
            sections += f"{remark}  {_xml(whole, text, 0)}\n"
    end = text.rindex("</mujoco")
    edits.append((end, end, sections))
    for start, stop, new in sorted(edits, reverse=True):
        text = text[:start] + new + text[stop:]
    return _bytes(text), drive.get("name", name)


def _finish_motor(motor: Element, own: _Markup, sides: Element, *, degrees: bool) -> None:
    """Put the motor's side of a gear train onto the hinge's axis."""
    lead, inertial = _child(motor, "joint"), _child(motor, "inertial")
    sides.set("armature", inertial.get("diaginertia", "").split()[0])
    inertial.attrib = dict(_FLANK)
    none = _NO_LOSSES | {"stiffness": "0", "actuatorfrclimited": "false"}
    same = {"axis": own.attrib.get("axis", "0 0 1"), "pos": own.attrib.get("pos", "0 0 0")}
    lead.attrib = none | lead.attrib | same
    if degrees and "range" in lead.attrib:
        lead.attrib |= limited(
            "", [math.degrees(float(end)) for end in lead.attrib["range"].split()]
        )


def limited(of: str, ends: Sequence[float]) -> dict[str, str]:
    """Attributes of a range."""
    return {f"{of}limited": "true", f"{of}range": " ".join(f"{end:.9g}" for end in ends)}


def _children(parts: Sequence[_Markup], section: str) -> list[_Markup]:
    return [one for one in parts if re.fullmatch(f"mujoco/{section}/[^/]+", one.path)]


def _child(made: Element, path: str) -> Element:
    child = made.find(path)
    assert child is not None, path
    return child


def _with(tag: str, attributes: Mapping[str, str]) -> str:
    """A tag with these attributes, in place of those it has."""
    for name in attributes:
        tag = re.sub(rf"""\s+{name}\s*=\s*("[^"]*"|'[^']*')""", "", tag)
    body, close = re.fullmatch(r"(.*?)(\s*/?>)", tag, re.DOTALL).groups()  # type: ignore[union-attr]
    return body + "".join(f" {k}={_raw(quoteattr(x))}" for k, x in attributes.items()) + close


def _indent(text: str, at: int) -> str:
    return re.search(r"[ \t]*\Z", text[:at]).group()  # type: ignore[union-attr]


def _xml(element: Element, text: str, at: int, before: str = "") -> str:
    """An element with the indentation of a place in the text."""
    if before:
        ElementTree.indent(element)
    written = _raw(ElementTree.tostring(element, encoding="unicode").strip().replace(" />", "/>"))
    return (before + written).replace("\n", f"\n{_indent(text, at)}")


def _raw(text: str) -> str:
    return text.encode().decode("latin-1")


def _bytes(text: str) -> bytes:
    return text.encode("latin-1")
