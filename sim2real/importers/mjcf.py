"""Robots from MJCF, compiled by MuJoCo."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sim2real.errors import InputError
from sim2real.extras import library
from sim2real.importers.chain import Body, Hinge, Tree
from sim2real.structured import read_text


def read_mjcf(path: str | os.PathLike[str]) -> Tree:
    """The bodies and hinges of an MJCF model in its reference pose.

    A joint's torque is the limit of the first actuator on it (``forcerange``, or the joint's
    ``actuatorfrcrange``). MJCF has no speed of a servo.

    Args:
        path: The file, with its meshes and includes.

    Raises:
        InputError: If MuJoCo is not installed or does not compile the file.
    """
    file = Path(path)
    read_text(file)
    mj = library("mujoco", str(file))
    try:
        model = mj.MjModel.from_xml_path(str(file))
    except (ValueError, mj.FatalError) as error:
        reason = " ".join(str(error).split())[:160]
        raise InputError(file, "", f"no model ({reason})", "MJCF that MuJoCo compiles") from None
    data = mj.MjData(model)
    mj.mj_kinematics(model, data)
    names = [model.body(k).name or f"body{k}" for k in range(model.nbody)]
    bodies = {}
    for k in range(1, model.nbody):
        frame = data.ximat[k].reshape(3, 3)
        inertia = frame @ np.diag(model.body_inertia[k]) @ frame.T
        parent = int(model.body_parentid[k])
        parent_name = names[parent] if parent else ""
        mass, position = float(model.body_mass[k]), data.xipos[k].copy()
        bodies[names[k]] = Body(names[k], parent_name, mass, position, inertia)
    hinged = {int(model.jnt_bodyid[j]) for j in range(model.njnt) if _turns(mj, model, j)}
    on_floor = [k for k in range(1, model.nbody) if model.body_parentid[k] == 0]
    if len(on_floor) != 1 or on_floor[0] in hinged:  # then the floor is the base
        for name in (names[k] for k in on_floor):
            bodies[name] = replace(bodies[name], parent=names[0])
        floor = Body(names[0], "", 0.0, np.zeros(3), np.zeros((3, 3)))
        bodies = {names[0]: floor} | bodies
    hinges, left_out = [], []
    for j in range(model.njnt):
        name = model.joint(j).name or f"joint{j}"
        if not _turns(mj, model, j):
            kind = mj.mjtJoint(model.jnt_type[j]).name.removeprefix("mjJNT_").lower()
            left_out.append(f"{name}: a {kind} joint: taken for stiff")
            continue
        limits = model.jnt_range[j] if model.jnt_limited[j] else None
        hinges.append(
            Hinge(
                name=name,
                body=names[model.jnt_bodyid[j]],
                axis=data.xaxis[j].copy(),
                origin=data.xanchor[j].copy(),
                limits=None if limits is None else (float(limits[0]), float(limits[1])),
                torque=_torque(mj, model, j),
            )
        )
        dof = model.jnt_dofadr[j]
        if model.dof_damping[dof] or model.dof_frictionloss[dof] or model.dof_armature[dof]:
            what = "damping, friction and armature (identify finds them)"
            left_out.append(f"{name}: {what}: not taken")
    for count, what in ((model.neq, "equality constraints"), (model.ntendon, "tendons")):
        if count:
            left_out.append(f"{what} ({count}): not taken")
    title = model.names[: model.names.index(b"\0")].decode() or file.stem
    return Tree(str(file), title, bodies, hinges, tuple(left_out))


def _turns(mj: Any, model: Any, joint: int) -> bool:  # noqa: ANN401 - MuJoCo's own types
    return bool(model.jnt_type[joint] == mj.mjtJoint.mjJNT_HINGE)


def _torque(mj: Any, model: Any, joint: int) -> float | None:  # noqa: ANN401
    """Torque limit of the actuator of a joint in N m, None if there is none."""
    for k in range(getattr(model, "nactuator", model.nu)):
        on_joint = model.actuator_trntype[k] == mj.mjtTrn.mjTRN_JOINT
        if on_joint and model.actuator_trnid[k, 0] == joint and model.actuator_forcelimited[k]:
            gear = abs(float(model.actuator_gear[k, 0]))
            return float(np.abs(model.actuator_forcerange[k]).max()) * gear
    if model.jnt_actfrclimited[joint]:
        return float(np.abs(model.jnt_actfrcrange[joint]).max())
    return None
