"""The text of an MJCF file with a servo on one of its hinges; all else stays as it is written."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

import numpy as np

from sim2real.errors import InputError, library
from sim2real.exporters.actuator import Export, LeftOut

_TAG = re.compile(r"""<(?:[^>"']|"[^"]*"|'[^']*')*>""")
_FLANK = {"pos": "0 0 0", "mass": "1e-6", "diaginertia": "1e-9 1e-9 1e-9"}
"""The motor's side of a gear train; its tendon has its inertia, which is about the shaft only."""
_NO_LOSSES = {"armature": "0", "damping": "0", "frictionloss": "0"}
Edit = tuple[int, int, str]
"""Ends of a part of the text, and what replaces it."""


@dataclass
class _Markup:
    """An element of a text: its tags from the root on, attributes and place."""

    path: str
    attrib: dict[str, str]
    start: int
    stop: int  # of its first tag
    end: int

    def with_attributes(self, text: str, attributes: Mapping[str, str]) -> Edit:
        """Its first tag with these attributes, in place of those it has."""
        tag = text[self.start : self.stop]
        for name in attributes:
            tag = re.sub(rf"""\s+{name}\s*=\s*("[^"]*"|'[^']*')""", "", tag)
        close = re.search(r"\s*/?>\Z", tag).start()  # type: ignore[union-attr]
        added = "".join(f" {name}={_raw(quoteattr(x))}" for name, x in attributes.items())
        return self.start, self.stop, tag[:close] + added + tag[close:]


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
        if text[part.stop - 2] != "/":
            part.end = text.index(">", parser.CurrentByteIndex) + 1

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.Parse(text.encode("latin-1"), True)
    return found


def with_servo(
    file: Path, content: bytes, compiled: tuple[Any, Any], name: str, bench: Export, *, adds: bool
) -> tuple[bytes, str, Sequence[LeftOut]]:
    """The content with the servo of a bench on a hinge, its actuator's name, and what it lacks.

    ``compiled`` are MuJoCo's specification and model of the content; with ``adds`` the armature of
    the hinge stays, beside the servo's. ``InputError`` if the hinge or its actuator is in a file
    that this one includes, or it has a servo that was written here.
    """
    (spec, model), lines = compiled, bench.left_out
    text, made = content.decode("latin-1"), ElementTree.fromstring(bench.text)
    parts, joint = _parts(text), model.joint(name)
    joints = (one for one in parts if re.fullmatch("mujoco/worldbody/.*joint", one.path))
    own = next((one for one in joints if one.attrib.get("name") == name), None)
    targets = {("joint", name), ("jointinparent", name)}
    acting = [x for x in _children(parts, "actuator") if targets & set(x.attrib.items())]
    limits = _limits(model, joint.id)
    if own is None or (limits and not acting):
        where = "a joint or an actuator of an included file"
        raise InputError(file, name, where, "the file that has both")
    title = f"<!-- {name}: identified by sim2real"
    if _raw(title) in text:
        raise InputError(file, name, "a servo that export-servo wrote", "the file from before that")
    shaft, drive = _child(made, "worldbody/body/joint"), _child(made, "actuator/*")
    given = {k: x for k, x in shaft.attrib.items() if k not in {"name", "type", "axis"}}
    limits = {"ctrllimited": "false", "forcelimited": "false", **limits}
    if "forcerange" in drive.attrib:
        limits["forcelimited"] = "true"
        given["actuatorfrclimited"] = str("actuatorfrcrange" in given).lower()
    elif theirs := limits.get("forcerange"):
        why = f"none was identified, so that of the file stays ({theirs} N m)"
        lines = (*lines, LeftOut(name, "a limit", why))
    given = _NO_LOSSES | given
    if armature := adds and float(model.dof_armature[joint.dofadr[0]]):
        given["armature"] = f"{armature + float(given['armature']):.9g}"
    edits = [own.with_attributes(text, given)]
    keys = [(key, dict[str, str]()) for key in _children(parts, "keyframe")]
    if (motor := made.find("worldbody/body/body")) is not None:
        _finish_motor(motor, own, _child(made, "tendon/fixed"), degrees=bool(spec.compiler.degree))
        ElementTree.indent(motor)
        inserted = f"\n{_indent(text, own.start)}{_xml(motor, text, own.start)}"
        edits.append((own.end, own.end, inserted))
        # its place is behind the joints of its body
        body = int(joint.bodyid[0])
        last = int(model.body_jntadr[body] + model.body_jntnum[body]) - 1
        behind = {"qpos": model.jnt_qposadr[last] + 1, "qvel": model.jnt_dofadr[last] + 1}
        for key, changed in keys:
            for kind, place in behind.items():
                if numbers := key.attrib.get(kind, "").split():
                    changed[kind] = " ".join([*numbers[:place], "0", *numbers[place:]])
    explicit = {"gear": "1", "actlimited": "false", "delay": "0", "nsample": "0"}
    explicit |= {"dyntype": "none"} if drive.tag == "general" else {}
    drive.attrib = explicit | limits | drive.attrib
    if delay := float(drive.attrib["delay"]):
        drive.set("nsample", str(math.ceil(delay / float(model.opt.timestep)) + 2))
    listed = "".join(f"\n    {line}".replace("--", "- -") for line in lines)
    comment = _raw(f"{title}; not expressed:{listed} -->" if lines else f"{title} -->")
    added = {section: made.findall(f"{section}/*") for section in ("tendon", "actuator", "sensor")}
    if acting:
        first, *others = acting
        drive.attrib |= {k: first.attrib[k] for k in first.attrib if k in {"name", "group", "user"}}
        replaced = f"{comment}\n{_indent(text, first.start)}{_xml(drive, text, first.start)}"
        edits.append((first.start, first.end, replaced))
        edits += [(one.start, one.end, "") for one in others]
        added["actuator"].remove(drive)
        comment = ""
    else:
        for key, changed in keys:
            if "ctrl" in key.attrib:
                changed["ctrl"] = f"{key.attrib['ctrl']} 0"
    edits += [key.with_attributes(text, changed) for key, changed in keys if changed]
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
    return text.encode("latin-1"), drive.get("name", name), lines


def _limits(model: Any, hinge: int) -> dict[str, str]:  # noqa: ANN401 - MuJoCo's own type
    """Attributes of the limits of a hinge's actuator; none without one."""
    kind = library("mujoco", "--into").mjtTrn
    kinds = int(kind.mjTRN_JOINT), int(kind.mjTRN_JOINTINPARENT)
    turn = np.isin(model.actuator_trntype, kinds) & (model.actuator_trnid[:, 0] == hinge)
    if not turn.any():
        return {}
    k, limits = int(np.flatnonzero(turn)[0]), {"ctrllimited": "false", "forcelimited": "false"}
    if model.actuator_forcelimited[k]:
        limits |= _limited("force", model.actuator_forcerange[k])
    at = getattr(model, "actuator_ctrladr", range(model.nu))[k]  # since MuJoCo 4
    gain, back = model.actuator_gainprm[k][0], model.actuator_biasprm[k][1]
    if gain and np.isclose(gain, -back, rtol=1e-3) and model.actuator_ctrllimited[at]:
        limits |= _limited("ctrl", model.actuator_ctrlrange[at])
    return limits


def _finish_motor(motor: Element, own: _Markup, sides: Element, *, degrees: bool) -> None:
    """Put the motor's side of a gear train onto the hinge's axis."""
    lead, inertial = _child(motor, "joint"), _child(motor, "inertial")
    sides.set("armature", inertial.get("diaginertia", "").split()[0])
    inertial.attrib = dict(_FLANK)
    none = _NO_LOSSES | {"stiffness": "0", "actuatorfrclimited": "false"}
    same = {"axis": own.attrib.get("axis", "0 0 1"), "pos": own.attrib.get("pos", "0 0 0")}
    lead.attrib = none | lead.attrib | same
    if degrees and "range" in lead.attrib:
        ends = [math.degrees(float(end)) for end in lead.attrib["range"].split()]
        lead.attrib |= _limited("", ends)


def _limited(of: str, ends: Sequence[float]) -> dict[str, str]:
    """Attributes of a range."""
    return {f"{of}limited": "true", f"{of}range": " ".join(f"{end:.9g}" for end in ends)}


def _children(parts: Sequence[_Markup], section: str) -> list[_Markup]:
    return [one for one in parts if re.fullmatch(f"mujoco/{section}/[^/]+", one.path)]


def _child(made: Element, path: str) -> Element:
    child = made.find(path)
    assert child is not None, path
    return child


def _indent(text: str, at: int) -> str:
    return re.search(r"[ \t]*\Z", text[:at]).group()  # type: ignore[union-attr]


def _xml(element: Element, text: str, at: int) -> str:
    """An element with the indentation of a place in the text."""
    written = ElementTree.tostring(element, encoding="unicode").strip().replace(" />", "/>")
    return _raw(written).replace("\n", f"\n{_indent(text, at)}")


def _raw(text: str) -> str:
    return text.encode().decode("latin-1")
