"""An identified servo in a user's own MJCF file, and its steps there beside the recorded ones.

The attributes of the joint of a bench (`mujoco`), its drive, tendons, sensor and the motor's side
of a gear train are written onto a hinge; inertia, weight and limits of angles stay the file's.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from sim2real.arrays import Array
from sim2real.errors import InputError, library, one_of
from sim2real.exporters.actuator import Export, LeftOut, listed
from sim2real.exporters.mujoco import expressed, mujoco
from sim2real.exporters.mujoco_bench import BRISTLES, simulated
from sim2real.exporters.nearest import Nearest, Which, fitting_data, nearest
from sim2real.identification.search import errors_of
from sim2real.model import FittedEffect, JointModel, Model
from sim2real.output import is_stream, protect
from sim2real.recording import Load, Recording
from sim2real.servo.parameters import joint_row
from sim2real.servo.trace import Trace

_PROLOGUE = re.compile(r"(\s|<\?.*?\?>|<!--.*?-->)*", re.DOTALL)
_OF_THE_LINK = {"gravity_load": "add the weight to the link", "sensor_offset": "add it to angles"}
_FLANK = {"pos": "0 0 0", "mass": "1e-6", "diaginertia": "1e-9 1e-9 1e-9"}
"""The motor's side of a gear train; its tendon has its inertia, which is about the shaft only."""


@dataclass(frozen=True)
class StepResponse:
    """Medians over the steps of one joint in one motion."""

    joint: str
    what: str  # recording, identified servo or file
    steps: int
    rise_s: float  # from 10 to 90 % of the motion
    overshoot: float  # beyond the last angles, as a share of the motion
    error_rad: float  # size of the difference of the last angles from the set-point

    def __str__(self) -> str:
        """A row of a table."""
        return (
            f"{self.joint}: rise {1e3 * self.rise_s:4.0f} ms, overshoot {1e2 * self.overshoot:4.1f}"
            f" %, steady error {1e3 * self.error_rad:5.1f} mrad: {self.what} ({self.steps} steps)"
        )


def responses(
    t: Array, command: Array, angle: Array, *, least_rad: float = 0.05, hold_s: float = 0.4
) -> Array:
    """Rise time in s, overshoot and steady error in rad of each step, shape (N, 3).

    Steps are of at least ``least_rad`` and held for ``hold_s``; the last fifth of a hold is where
    the joint settles. Times in s, set-points and angles in rad (T,); angles may have NaN.
    """
    starts = np.flatnonzero(np.diff(command)) + 1
    rows = []
    for start, end in zip(starts, [*starts[1:], t.size], strict=True):
        part = np.arange(start, end)[np.isfinite(angle[start:end])]
        small = abs(command[start] - command[start - 1]) < least_rad
        if small or part.size < 2 or t[part[-1]] - t[start] < hold_s:
            continue
        since, seen = t[part] - t[start], angle[part]
        settled = float(np.mean(seen[since >= 0.8 * since[-1]]))
        if abs(settled - seen[0]) < least_rad / 2:
            continue
        moved = (seen - seen[0]) / (settled - seen[0])
        ends = []
        for level in (0.1, 0.9):
            k = int(np.argmax(moved >= level))
            ends.append(np.interp(level, moved[k - 1 : k + 1], since[k - 1 : k + 1]))
        error = abs(settled - command[start])
        rows.append((ends[1] - ends[0], max(float(moved.max()) - 1, 0.0), error))
    return np.array(rows).reshape(-1, 3)


def into_robot(
    file: Path,
    names: Sequence[str],
    out: Path,
    model: Model,
    recordings: Sequence[Recording] = (),
    which: Which = "nearest",
) -> tuple[Export, Nearest, tuple[StepResponse, ...]]:
    """An MJCF file with identified servos on its hinges ``names``, and their steps in it.

    The servo of a hinge is the model's joint of that name, or its only one. Gains per unit of
    inertia are multiplied by the inertia about the hinge. Steps are those of recordings (held-out
    ones where these have steps) or standard ones, at the file's time step, with other joints held
    at the first keyframe or the reference pose and without contacts. ``InputError`` if MuJoCo is
    missing or cannot load the file, also in the folder of ``out``, or the file lacks a hinge.
    """
    library("mujoco", "--into")
    protect(file)
    robot = _Compiled.loaded(file)
    text = file.read_text(encoding="utf-8")
    prologue = _PROLOGUE.match(text)
    parser = ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
    root = ElementTree.fromstring(text, parser)
    owns = {name: _own(name, model) for name in names}
    joints = {own: model.joints[own] for own in owns.values()}
    made = nearest(Model(joints), lambda x: expressed(x) - BRISTLES, recordings, which=which)
    lines, steps = list[LeftOut](), list[StepResponse]()
    for name, own in owns.items():
        dof, found = robot.dof(name, file), made.model.joints[own]
        before = float(robot.model.dof_armature[dof]) if found.per_inertia else 0.0
        servo, kept = _on_inertia(name, found, robot.inertia(dof))
        dropped = [line for line in made.dropped if line.component == own]
        bench = mujoco(Model({name: servo}), None, (*dropped, *kept))
        theirs = robot.limits(int(robot.model.joint(name).id)).get("forcerange")
        if theirs and "forcerange" not in bench.text:
            why = f"none was identified, so that of the file stays ({theirs} N m)"
            bench = replace(bench, left_out=(*bench.left_out, LeftOut(name, "a limit", why)))
        lines += bench.left_out
        drive = _Edit(file, name, robot, root).with_servo(bench, before)
        text = ElementTree.tostring(root, encoding="unicode").replace(" />", "/>")
        text = f"{prologue.group() if prologue else ''}{text}\n"
        robot = _Compiled.loaded(out, file, text)
        data = fitting_data(own, joints[own], recordings, None)
        ways = (data.scored, data.held_out), (data.fitted, "recordings"), (data.own, "")
        for traces, what in ways[0 if data.scored else 2 :]:
            if any(len(responses(x.t, x.command, x.measured)) for x in traces):
                steps += robot.steps((name, drive), found, traces, what, out.name)
                break
    return Export(text, tuple(lines)), made, tuple(steps)


def _own(name: str, model: Model) -> str:
    """The model's joint for a hinge."""
    if name not in model.joints and len(model.joints) > 1:
        raise InputError("model", name, "no such joint", one_of(name, [*model.joints]))
    return name if name in model.joints else next(iter(model.joints))


def _on_inertia(name: str, joint: JointModel, inertia: float) -> tuple[JointModel, list[LeftOut]]:
    """A joint without effects of link or observation; with gains per inertia, for this one."""

    def sized(values: Mapping[str, float]) -> dict[str, float]:
        power = {n: -1 if "per_Nm" in n else int("Nm" in n or "kgm2" in n) for n in values}
        return {n: x * inertia ** power[n] for n, x in values.items()}

    lost, effects = [], []
    for fitted in joint.effects:
        why = _OF_THE_LINK.get(fitted.effect)
        if fitted.parameters.get("inertia_kgm2", 0.0) < 0:
            why = "subtract it from the link's inertia"
        if why is None:
            effects.append(fitted)
        elif any(fitted.parameters.values()):
            lost.append(LeftOut(name, listed(fitted.effect, fitted.parameters), why))
    joint = replace(joint, effects=tuple(effects))
    if joint.per_inertia:
        joint = replace(
            joint,
            kp_Nm_per_rad=inertia * joint.kp_Nm_per_rad,
            kd_Nms_per_rad=inertia * joint.kd_Nms_per_rad,
            motor=sized(joint.motor),
            effects=tuple(FittedEffect(e.effect, sized(e.parameters)) for e in effects),
            per_inertia=False,
            inertia_kgm2=inertia,
            load=Load(inertia),
        )
    return joint, lost


@dataclass(frozen=True)
class _Compiled:
    """A file as MuJoCo has it."""

    mj: Any
    spec: Any
    model: Any

    @classmethod
    def loaded(cls, file: Path, source: Path | None = None, text: str = "") -> _Compiled:
        """The file, or a text that is to be this file and was made from ``source``."""
        mj = library("mujoco", "--into")
        try:
            if source is None:
                spec = mj.MjSpec.from_file(str(file))
                return cls(mj, spec, spec.compile())
            folder = source.parent if is_stream(file) else file.parent
            with tempfile.NamedTemporaryFile("w", dir=folder, prefix=".", suffix=".xml") as there:
                there.write(text)
                there.flush()
                spec = mj.MjSpec.from_file(there.name)
                return cls(mj, spec, spec.compile())
        except (ValueError, RuntimeError) as error:
            expected = "an MJCF file that MuJoCo loads"
            if source is not None:
                expected += f", in the folder of {source} if that has further files"
            raise InputError(file, "", str(error).strip(), expected) from None

    def dof(self, name: str, file: Path) -> int:
        """Place of a hinge among the degrees of freedom."""
        kind = self.mj.mjtJoint.mjJNT_HINGE
        all_joints = map(self.model.joint, range(self.model.njnt))
        hinges = {one.name: int(one.dofadr[0]) for one in all_joints if one.type[0] == kind}
        if name not in hinges:
            raise InputError(file, name, "no such hinge", one_of(name, [*hinges]))
        return hinges[name]

    def posed(self) -> Any:  # noqa: ANN401
        """Data at the first keyframe, or where there is none in the reference pose."""
        data = self.mj.MjData(self.model)
        if self.model.nkey:
            self.mj.mj_resetDataKeyframe(self.model, data, 0)
        return data

    def inertia(self, dof: int) -> float:
        """Inertia about a hinge in kg m2, its armature included."""
        data, column = self.posed(), np.zeros(self.model.nv)
        self.mj.mj_forward(self.model, data)
        self.mj.mj_mulM(self.model, data, column, np.eye(self.model.nv)[dof])
        return float(column[dof])

    def limits(self, hinge: int) -> dict[str, str]:
        """Limits of torque and set-points of the actuator of a hinge; empty without one."""
        model, kind = self.model, self.mj.mjtTrn
        kinds = int(kind.mjTRN_JOINT), int(kind.mjTRN_JOINTINPARENT)
        for k in range(model.nu):
            if model.actuator_trntype[k] not in kinds or model.actuator_trnid[k][0] != hinge:
                continue
            limits = {"ctrllimited": "false", "forcelimited": "false"}
            if model.actuator_forcelimited[k]:
                limits |= _range("force", model.actuator_forcerange[k])
            at = getattr(model, "actuator_ctrladr", range(model.nu))[k]  # since MuJoCo 4
            gain, back = model.actuator_gainprm[k][0], model.actuator_biasprm[k][1]
            if gain and np.isclose(gain, -back, rtol=1e-3) and model.actuator_ctrllimited[at]:
                limits |= _range("ctrl", model.actuator_ctrlrange[at])
            return limits
        return {}

    def steps(
        self, names: Sequence[str], joint: JointModel, data: Sequence[Trace], what: str, file: str
    ) -> list[StepResponse]:
        """Steps as recorded (``what``), of the identified servo on that load, and in the robot."""
        name, drive = names  # of the hinge and of its actuator
        hinge, off = self.model.joint(name), self.mj.mjtDisableBit
        here = f"{file}, {self.inertia(int(hinge.dofadr[0])):.3g} kg m2"
        moving = {name, f"{name}_lead"}
        joints = [self.model.joint(k).name for k in self.model.dof_jntid]
        others = [k for k, one in enumerate(joints) if one not in moving]
        self.model.dof_armature[others] += 1e6  # holds them
        self.model.opt.disableflags |= off.mjDSBL_CONTACT | off.mjDSBL_EQUALITY
        rows: dict[str, list[Array]] = {}
        for trace in data:
            errors = errors_of(joint_row(joint, trace.load), [trace])[0]
            first = trace.position[trace.used][0] - self.model.qpos0[hinge.qposadr[0]]
            start, sent = {name: float(first)}, {name: trace.command}
            motions = {what: trace.measured} if what else {}
            load = "" if joint.per_inertia else f", {trace.load.inertia_kgm2:.3g} kg m2"
            motions[f"predict{load}"] = trace.simulated(errors)
            motions[here] = simulated(self.model, trace.t, sent, start, {name: drive})[name]
            for kind, angle in motions.items():
                part = np.where(trace.used, angle, np.nan)
                rows.setdefault(kind, []).append(responses(trace.t, trace.command, part))
        return [
            StepResponse(name, kind, len(steps), *map(float, np.median(steps, axis=0)))
            for kind, parts in rows.items()
            if len(steps := np.concatenate(parts))
        ]


@dataclass(frozen=True)
class _Edit:
    """An MJCF file as a tree, a hinge of which gets a servo."""

    file: Path
    name: str  # of the hinge
    robot: _Compiled
    root: Element

    def with_servo(self, bench: Export, armature: float) -> str:
        """The name of the actuator, having put the servo of a bench on the hinge."""
        made, name, model = ElementTree.fromstring(bench.text), self.name, self.robot.model
        joints = (one for world in self.root.iter("worldbody") for one in world.iter("joint"))
        own = next((one for one in joints if one.get("name") == name), None)
        if own is None:
            where = "a joint of an included file"
            raise InputError(self.file, name, where, "the file that has the joint itself")
        shaft, drive = _child(made, "worldbody/body/joint"), _child(made, "actuator/*")
        given = {k: x for k, x in shaft.attrib.items() if k not in {"name", "type", "axis"}}
        theirs = self.robot.limits(int(model.joint(name).id))
        limits = theirs or {"ctrllimited": "false", "forcelimited": "false"}
        if "forcerange" in drive.attrib:
            limits |= {"forcelimited": "true"}
            given["actuatorfrclimited"] = str("actuatorfrcrange" in given).lower()
        own.attrib |= {"armature": "0", "damping": "0", "frictionloss": "0"} | given
        if armature:
            own.set("armature", f"{armature + float(given.get('armature', 0)):.9g}")
        samples = np.ceil(float(drive.get("delay", 0)) / model.opt.timestep) + 2
        explicit = {"gear": "1", "actlimited": "false", "delay": "0"}
        explicit |= {"dyntype": "none"} if drive.tag == "general" else {}
        drive.attrib = explicit | limits | drive.attrib
        drive.set("nsample", str(int(samples)) if drive.get("delay") != "0" else "0")
        if (motor := made.find("worldbody/body/body")) is not None:
            self._add_motor(own, motor, _child(made, "tendon/fixed"))
        self._replace_drive(drive, bench.left_out, there=bool(theirs))
        for section in ("tendon", "actuator", "sensor"):
            for element in made.findall(f"{section}/*"):
                if element is not drive:
                    self._put(section, element)
        return drive.get("name", name)

    def _add_motor(self, own: Element, motor: Element, sides: Element) -> None:
        """Add the motor's side of a gear train; keyframes get its angle and speed, 0."""
        parent, model = next(one for one in self.root.iter() if own in list(one)), self.robot.model
        lead, inertial = _child(motor, "joint"), _child(motor, "inertial")
        sides.set("armature", inertial.get("diaginertia", "").split()[0])
        inertial.attrib = dict(_FLANK)
        same = {k: own.get(k, x) for k, x in (("axis", "0 0 1"), ("pos", "0 0 0"))}
        none = dict.fromkeys(("armature", "damping", "frictionloss", "stiffness"), "0")
        lead.attrib = none | {"actuatorfrclimited": "false"} | lead.attrib | same
        if self.robot.spec.compiler.degree and "range" in lead.attrib:
            ends = [float(end) for end in lead.attrib["range"].split()]
            lead.set("range", _range("", np.degrees(ends))["range"])
        _insert(parent, list(parent).index(own) + 1, motor)
        body = int(model.joint(self.name).bodyid[0])
        last = int(model.body_jntadr[body] + model.body_jntnum[body]) - 1
        for key in self.root.iterfind("keyframe/key"):
            for kind, place in ("qpos", model.jnt_qposadr), ("qvel", model.jnt_dofadr):
                if values := key.get(kind, "").split():
                    values.insert(int(place[last]) + 1, "0")
                    key.set(kind, " ".join(values))

    def _replace_drive(self, drive: Element, lines: Sequence[LeftOut], *, there: bool) -> None:
        """Put the drive in place of the hinge's actuator, whose name it gets, below a comment."""
        remarks = "".join(f"\n    {line}".replace("--", "- -") for line in lines)
        said = f" {self.name}: identified by sim2real"
        comment = ElementTree.Comment(f"{said}; not expressed:{remarks} " if lines else f"{said} ")
        own = {("joint", self.name), ("jointinparent", self.name)}
        sections = self.root.findall("actuator")
        if any(str(one.text).startswith(said) for part in sections for one in part):
            found = "a servo that export-servo wrote"
            raise InputError(self.file, self.name, found, "the file from before that")
        theirs = [(part, one) for part in sections for one in part if own & set(one.attrib.items())]
        if there and not theirs:
            where = "its actuator in an included file"
            raise InputError(self.file, self.name, where, "both in one file")
        if not theirs:
            self._put("actuator", drive)
            for key in self.root.iterfind("keyframe/key[@ctrl]"):
                key.set("ctrl", f"{key.get('ctrl')} 0")
            theirs = [(self.root.findall("actuator")[-1], drive)]
        section, first = theirs[0]
        drive.attrib |= {k: x for k, x in first.attrib.items() if k in {"name", "group", "user"}}
        at, drive.tail = list(section).index(first), first.tail
        section[at] = drive
        for part, other in theirs[1:]:
            part.remove(other)
        _insert(section, at, comment)

    def _put(self, section: str, element: Element) -> None:
        """Put an element in place of that of its name, or at the end of the last section."""
        sections = self.root.findall(section)
        for part in sections:
            for k, old in enumerate(part):
                if old.get("name") == element.get("name"):
                    element.tail, part[k] = old.tail, element
                    return
        if not sections:
            sections = [Element(section)]
            _insert(self.root, len(self.root), sections[0])
            sections[0].text = "\n    "
        _insert(sections[-1], len(sections[-1]), element)


def _insert(parent: Element, at: int, element: Element[Any]) -> None:
    """Insert an element with the white space of its siblings."""
    between = parent.text or "\n"
    ElementTree.indent(element, level=len(between.strip("\n")) // 2)
    element.tail = between
    if at == len(parent):
        element.tail = parent[-1].tail if at else between[:-2]
    if at == len(parent) and at:
        parent[-1].tail = between
    parent.insert(at, element)


def _child(made: Element, path: str) -> Element:
    child = made.find(path)
    assert child is not None, path
    return child


def _range(of: str, ends: Sequence[float] | Array) -> dict[str, str]:
    return {f"{of}limited": "true", f"{of}range": " ".join(f"{end:.9g}" for end in ends)}
