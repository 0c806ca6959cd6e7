"""Dynamics of an arm's rigid bodies, by Pinocchio.

Carpentier et al., The Pinocchio C++ library, IEEE/SICE International Symposium on System
Integration (2019) 614-619.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sim2real.arm.description import Arm
from sim2real.arrays import Array
from sim2real.errors import InputError, library


class Multibody:
    """Inertias and torques of an arm of J joints in motion, with angles as recorded.

    Raises:
        InputError: If Pinocchio is not installed, or it does not accept the URDF.
    """

    def __init__(self, arm: Arm) -> None:
        self.arm = arm
        self._library = library("pinocchio", arm.file)
        self._model = self._reduced()
        self._data = self._model.createData()
        order = [self._model.getJointId(joint.urdf_joint) for joint in arm.joints]
        self._place = np.array([self._model.joints[k].idx_v for k in order])
        self._direction = np.array([joint.direction for joint in arm.joints])
        self._zero = np.array([joint.zero_rad for joint in arm.joints])
        self._check_inertia()

    def loads(self, angle: Array, velocity: Array, acceleration: Array) -> tuple[Array, Array]:
        """Inertia and torque that each joint's servo sees of the moving arm.

        With the equations of motion M(q) q'' + C(q, q') q' + g(q) = T (any text on robot dynamics),
        servo j sees M_jj q_j'' = T_j + load_j, so that load_j = M_jj q_j'' - T_j: gravity, Coriolis
        and centrifugal torques, and what the other joints' accelerations exert.

        Angles in rad, speeds in rad/s and accelerations in rad/s2 are of shape (T, J), as are the
        inertias M_jj in kg m2 and the torques on the shafts in N m.
        """
        q, v, a = (np.zeros((len(angle), self._model.nv)) for _ in range(3))
        q[:, self._place] = self._direction * (angle - self._zero)
        v[:, self._place] = self._direction * velocity
        a[:, self._place] = self._direction * acceleration
        inertia, total = np.empty_like(q), np.empty_like(q)
        rnea, crba = self._library.rnea, self._library.crba
        for k in range(len(q)):
            total[k] = rnea(self._model, self._data, q[k], v[k], a[k])
            inertia[k] = np.diagonal(crba(self._model, self._data, q[k]))
        load = inertia * a - total
        return inertia[:, self._place], self._direction * load[:, self._place]

    def mass_matrix(self, angle: Array) -> Array:
        """Mass matrices M(q) in kg m2 at angles (T, J), shape (T, J, J)."""
        q = np.zeros((len(angle), self._model.nv))
        q[:, self._place] = self._direction * (angle - self._zero)
        matrices = np.empty((len(q), q.shape[1], q.shape[1]))
        for k in range(len(q)):
            upper = np.triu(self._library.crba(self._model, self._data, q[k]))
            matrices[k] = upper + np.triu(upper, 1).T
        chosen = matrices[:, self._place[:, None], self._place]
        return np.asarray(self._direction[:, None] * chosen * self._direction)

    def _reduced(self) -> Any:  # noqa: ANN401 - Pinocchio has no stubs
        """Pinocchio's model of the arm, with all other joints of the URDF locked at 0."""
        library, arm = self._library, self.arm
        try:
            whole = library.buildModelFromXML(arm.urdf)
        except (ValueError, RuntimeError) as error:
            reason = " ".join(str(error).split())[:160]
            expected = "a URDF that Pinocchio reads"
            raise InputError(arm.file, "", f"no model ({reason})", expected) from None
        named = {joint.urdf_joint for joint in arm.joints}
        absent = named - set(whole.names)
        if absent:
            found = f"no joint {', '.join(sorted(absent))}"
            raise InputError(arm.file, "joints", found, f"joints of {', '.join(whole.names[1:])}")
        locked = [k for k, name in enumerate(whole.names) if k and name not in named]
        model = library.buildReducedModel(whole, locked, library.neutral(whole))
        model.gravity.linear = np.array(arm.gravity_m_s2)
        return model

    def _check_inertia(self) -> None:
        diagonal = np.diagonal(self.mass_matrix(self._zero[None])[0])
        for joint, inertia in zip(self.arm.joints, diagonal, strict=True):
            if inertia <= 0:
                place = f"joint {joint.urdf_joint}"
                found = "no mass and no inertia beyond it"
                raise InputError(self.arm.file, place, found, "<inertial> of the links it moves")
