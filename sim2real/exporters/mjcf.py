"""An identified servo in a user's own MJCF file, and its steps there beside the recorded ones.

The attributes of the joint of a bench (`mujoco`), its drive, tendons, sensor and the motor's side
of a gear train are written onto a hinge; inertia, weight and limits of angles stay the file's.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.parsers.expat import ExpatError

import numpy as np

from sim2real.arrays import Array
from sim2real.errors import InputError, library, one_of
from sim2real.exporters.actuator import Export, LeftOut, listed
from sim2real.exporters.mjcf_text import with_servo
from sim2real.exporters.mujoco import expressed, mujoco
from sim2real.exporters.mujoco_bench import BRISTLES, simulate
from sim2real.exporters.nearest import Which, excitation, fitting_data, nearest
from sim2real.identification.search import errors_of
from sim2real.model import FittedEffect, JointModel, Model
from sim2real.output import is_stream, protect
from sim2real.recording import Load, Recording
from sim2real.servo.parameters import joint_row
from sim2real.servo.trace import Trace

_OF_THE_LINK = {"gravity_load": "add the weight to the link", "sensor_offset": "add it to angles"}


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
        if not self.steps:
            return f"{self.joint}: no step moves it by half its size: {self.what}"
        return (
            f"{self.joint}: rise {1e3 * self.rise_s:4.0f} ms, overshoot {1e2 * self.overshoot:4.1f}"
            f" %, steady error {1e3 * self.error_rad:5.1f} mrad: {self.what} ({self.steps} steps)"
        )


def responses(t: Array, command: Array, angle: Array) -> Array:
    """Rise time in s, overshoot and steady error in rad of each step, shape (N, 3).

    Steps are of at least 50 mrad and held for 0.4 s; the last fifth of a hold is where the joint
    settles. Times in s, set-points and angles in rad (T,); angles may have NaN.
    """
    starts, least_rad = np.flatnonzero(np.diff(command)) + 1, 0.05
    rows = []
    for start, stop in zip(starts, [*starts[1:], t.size], strict=True):
        part = np.arange(start, stop)[np.isfinite(angle[start:stop])]
        small = abs(command[start] - command[start - 1]) < least_rad
        if small or part.size < 2 or t[part[-1]] - t[start] < 0.4:
            continue
        since, seen = t[part] - t[start], angle[part]
        settled = float(np.mean(seen[since >= 0.8 * since[-1]]))
        if abs(settled - seen[0]) < least_rad / 2:
            continue
        moved = np.maximum.accumulate((seen - seen[0]) / (settled - seen[0]))
        begin, end = np.interp([0.1, 0.9], moved, since)
        rows.append((end - begin, max(moved[-1] - 1, 0.0), abs(settled - command[start])))
    return np.array(rows).reshape(-1, 3)


def into_robot(
    file: Path,
    out: Path,
    names: Sequence[str],
    model: Model,
    recordings: Sequence[Recording] = (),
    which: Which = "nearest",
) -> Export:
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
    content = file.read_bytes()
    (only, *others), known = model.joints, set(model.joints)
    owns = {name: only if not others and name not in known else name for name in names}
    if unknown := set(owns.values()) - known:
        raise InputError("model", min(unknown), "no such joint", one_of(min(unknown), [*known]))
    joints = {own: model.joints[own] for own in owns.values()}
    made = nearest(Model(joints), lambda x: expressed(x) - BRISTLES, recordings, which=which)
    lines, steps = list[LeftOut](), list[StepResponse]()
    for name, own in owns.items():
        found, hinges = made.model.joints[own], robot.hinges()
        if name not in hinges:
            raise InputError(file, name, "no such hinge", one_of(name, hinges))
        servo, kept = _on_inertia(name, found, robot.inertia(name))
        dropped = [line for line in made.dropped if line.component == own]
        bench = mujoco(Model({name: servo}), None, (*dropped, *kept))
        given = content, (robot.spec, robot.model), name, bench
        try:
            content, drive, left = with_servo(file, *given, adds=found.per_inertia)
            text = content.decode()
        except (ExpatError, UnicodeDecodeError) as error:
            raise InputError(file, "", str(error), "XML in UTF-8") from None
        lines += left
        robot = _Compiled.loaded(out, file, content)
        data = fitting_data(own, joints[own], recordings, None)
        ways = [(data.scored, data.held_out), (data.fitted, "recordings")] if data.scored else []
        for traces, what in (*ways, (robot.reach(found, name), "")):
            if any(len(responses(x.t, x.command, x.measured)) for x in traces):
                steps += robot.steps((name, drive), found, traces, what, out.name)
                break
    errors = {"compared": made.compared, "refitted": made.refits, "steps": tuple(steps)}
    return Export(text, tuple(lines), errors)


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

    spec: Any
    model: Any

    @classmethod
    def loaded(cls, file: Path, source: Path | None = None, content: bytes = b"") -> _Compiled:
        """The file, or a content that is to be this file and was made from ``source``."""
        mj = library("mujoco", "--into")
        expected = "an MJCF file that MuJoCo loads"
        try:
            if source is None:
                spec = mj.MjSpec.from_file(str(file))
                return cls(spec, spec.compile())
            expected += f", in the folder of {source} if that has further files"
            folder = source.parent if is_stream(file) else file.parent
            with tempfile.NamedTemporaryFile(dir=folder, prefix=".", suffix=".xml") as there:
                there.write(content)
                there.flush()
                spec = mj.MjSpec.from_file(there.name)
                return cls(spec, spec.compile())
        except (ValueError, RuntimeError) as error:
            raise InputError(file, "", str(error).strip(), expected) from None

    def hinges(self) -> list[str]:
        """Names of its hinges."""
        kind = library("mujoco", "--into").mjtJoint.mjJNT_HINGE
        joints = map(self.model.joint, range(self.model.njnt))
        return [joint.name for joint in joints if joint.type[0] == kind]

    def posed(self) -> Any:  # noqa: ANN401
        """Data at the first keyframe, or where there is none in the reference pose."""
        mj = library("mujoco", "--into")
        data = mj.MjData(self.model)
        if self.model.nkey:
            mj.mj_resetDataKeyframe(self.model, data, 0)
        mj.mj_forward(self.model, data)
        return data

    def inertia(self, name: str) -> float:
        """Inertia about a hinge in kg m2, its armature included."""
        dof, column = int(self.model.joint(name).dofadr[0]), np.zeros(self.model.nv)
        unit = np.eye(self.model.nv)[dof]
        library("mujoco", "--into").mj_mulM(self.model, self.posed(), column, unit)
        return float(column[dof])

    def reach(self, joint: JointModel, name: str) -> list[Trace]:
        """Standard steps of a servo about the middle of what a hinge can reach."""
        hinge = self.model.joint(name)
        pose = float(self.posed().qpos[hinge.qposadr[0]])
        low, high = hinge.range if self.model.jnt_limited[hinge.id] else (pose - 3.0, pose + 3.0)
        size = min(0.6, 0.4 * (high - low))
        middle = float(np.clip(pose, low + size, high - size))
        own = excitation(joint, name, size)
        return [replace(x, command=x.command + middle, position=x.position + middle) for x in own]

    def steps(
        self, names: Sequence[str], joint: JointModel, data: Sequence[Trace], what: str, file: str
    ) -> list[StepResponse]:
        """Steps as recorded (``what``), of the identified servo on that load, and in the robot."""
        name, drive = names  # of the hinge and of its actuator
        model, off = copy(self.model), library("mujoco", "--into").mjtDisableBit
        hinge = model.joint(name)
        here = f"{file}, {self.inertia(name):.3g} kg m2"
        joints = [model.joint(k).name for k in model.dof_jntid]
        held = [k for k, one in enumerate(joints) if one not in {name, f"{name}_lead"}]
        model.dof_armature[held] += 1e6
        model.opt.disableflags |= off.mjDSBL_CONTACT | off.mjDSBL_EQUALITY
        rows: dict[str, list[Array]] = {}
        for trace in data:
            errors = errors_of(joint_row(joint, trace.load), [trace])[0]
            first = trace.position[trace.used][0] - model.qpos0[hinge.qposadr[0]]
            start, sent = {name: float(first)}, {name: trace.command}
            motions = {what: trace.measured} if what else {}
            load = "" if joint.per_inertia else f", {trace.load.inertia_kgm2:.3g} kg m2"
            motions[f"predict{load}"] = trace.simulated(errors) if what else trace.position
            motions[here] = simulate(model, trace.t, sent, start, drives={name: drive})[name]
            for kind, angle in motions.items():
                part = np.where(trace.used, angle, np.nan)
                rows.setdefault(kind, []).append(responses(trace.t, trace.command, part))
        return [
            StepResponse(name, kind, len(steps), *map(float, np.median(steps, axis=0)))
            if len(steps := np.concatenate(parts))
            else StepResponse(name, kind, 0, np.nan, np.nan, np.nan)
            for kind, parts in rows.items()
        ]
