"""Robots in a simulated pool that is independent of the library: one box of water for each.

The water is the lattice-Boltzmann fluid of ``sim`` in cells of its own size, with another
viscosity, another sub-grid constant, another friction line and other relaxation times than what is
calibrated and trained in. Its joints are slack: servos and all other forces are computed by this
folder in NumPy, for all robots at once, and share no code with the library's laws.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from servos import LooseFin, Servos
from surfaces import Links, Surfaces
from truth import Truth, values
from waters import POOL_HALF_M, Waters

from sim.fluid.fluid import WINDOW_M, Fluid
from sim.fluid.wall import Wall
from sim.robot.swimmer import CONTROL_S, Swimmer
from sim2real.model import JointModel, Model
from sim2real.robot import Robot, read_robot

Array = NDArray[np.float64]

ROBOT = Path(__file__).parent / "robot.toml"
VISCOSITY_M2_S = 4e-5
SMAGORINSKY, MAGIC = 0.14, 1e-2
"""Of the sub-grid viscosity, and of the two relaxation times; the library has 0.17 and 3/16."""
LINE = "laminar"
"""Of friction: Blasius's; the library's robots have the turbulent one."""
EDGE = 0.65
DEPTH_M = 0.4
WILD_M_S = 2.0
"""Speed from which a box counts as stopped, as unstable."""


@dataclass(frozen=True)
class Water:
    """Parameters of the water; the defaults are those of the recordings that ship.

    Attributes:
        viscosity_m2_s: Away from the wall.
        smagorinsky: Of the sub-grid viscosity.
        magic: Of the two relaxation times.
        line: Friction line of a smooth surface.
        edge: Distance in cells by which the edges of fins are moved inwards; the library has 0.5.
        box_m: Length, width and depth of a robot's box.
    """

    viscosity_m2_s: float = VISCOSITY_M2_S
    smagorinsky: float = SMAGORINSKY
    magic: float = MAGIC
    line: str = LINE
    edge: float = EDGE
    box_m: tuple[float, float, float] = WINDOW_M


class World:
    """Robots of one file, each with its concealed parameters.

    Attributes:
        robot: Links and joints.
        truths: Concealed parameters of each of the E robots.
        swimmer: The water and the bodies in it.
    """

    def __init__(
        self,
        truths: Sequence[Truth],
        *,
        device: str,
        cell_m: float,
        rng: np.random.Generator,
        robot: Robot | None = None,
        water: Water | None = None,
    ) -> None:
        """Fill the boxes, with the robots straight and at rest.

        Args:
            truths: One for each box.
            device: ``cpu`` or ``cuda:0``.
            cell_m: Side of a cell.
            rng: Of random drifts.
            robot: Links and joints; those of ``robot.toml`` where None.
            water: Parameters of the water.
        """
        self.robot, self.truths = robot or read_robot(ROBOT), list(truths)
        water = water or Water()
        slack = JointModel(1e-12, 0.0, 0.0, 0.001)
        joints = {joint.name: slack for joint in self.robot.joints}
        models = [Model(joints=joints, body=_weighed(truth)) for truth in self.truths]
        with _other_collision(water.magic):
            self.swimmer = Swimmer(
                without_drag(self.robot), models, n_envs=len(truths), cell_m=cell_m, device=device,
                viscosity_m2_s=water.viscosity_m2_s, smagorinsky=water.smagorinsky,
                wall=Wall(True, water.line, edge=water.edge), box_m=water.box_m,
                substeps=max(32, 2 * int(np.ceil(CONTROL_S * 1.4 / 0.15 / cell_m / 2))), threads=2,
            )  # fmt: skip
        self.h = CONTROL_S / self.swimmer.substeps
        self.servos = Servos(self.truths, len(self.robot.joints), self.h, rng)
        self.fin = LooseFin(self.truths, self.h)
        chain, hull = self.swimmer.bodies.chain, self.swimmer.hull
        links = Links(hull, chain.com.numpy()[:, 0], chain.side.numpy()[:, 0])
        self.surfaces = Surfaces(self.truths, self.robot, hull, links)
        self.waters = Waters(self.truths, hull, links, self.h)
        self._trim = self._column("trim_asymmetry", "offset_rad")
        self._stiff = self._column("skin_elasticity", "stiffness_Nm_per_rad")
        self._soft = self._column("skin_viscoelasticity", "stiffness_Nm_per_rad")
        self._relax = np.maximum(self._column("skin_viscoelasticity", "relaxation_s"), 1e-3)
        self._damp = self._column("skin_damping", "damping_Nms_per_rad")
        self._tied = self._column("skin_coupling", "stiffness_Nm_per_rad")
        self._tether = self._column("tether", "stiffness_N_per_m")
        self._anchor = np.stack([values(truths, "tether", n) for n in ("x_m", "y_m")], axis=1)
        self._current = np.stack(
            [values(truths, "pool_current", n) for n in ("u_m_s", "v_m_s")], axis=1
        )
        self._seiche = np.stack([values(truths, "seiche", n) for n in ("speed_m_s", "mode")])
        self._tilt = values(truths, "seiche", "direction_rad")
        self.reset()

    def _column(self, effect: str, name: str) -> Array:
        return values(self.truths, effect, name)[:, None]

    def reset(self, pose: Array | None = None, joint: Array | None = None) -> None:
        """Put all robots at rest in water at rest; with a current, both move with it.

        Args:
            pose: x, y of the head's centre of mass and heading, shape (E, 3); at the origin where
                None.
            joint: Joint angles as the servos show them, shape (E, J); straight where None.
        """
        self.swimmer.reset(pose=pose, joint=joint)
        motion = self.swimmer.bodies.motion
        q = motion.q.numpy().copy()
        q[:, 3:] += self._trim
        self.swimmer.bodies.place(q)
        self._strain = np.zeros((len(self.truths), len(self.robot.joints)))
        self._drift = np.zeros((len(self.truths), 2))
        self.servos.reset(q[:, 3:])
        self.fin.reset(q[:, -1])
        self.waters.reset()
        self._periods = 0

    @property
    def t(self) -> float:
        """Seconds since the robots were put there."""
        return CONTROL_S * self._periods

    def where(self) -> tuple[Array, Array]:
        """Poses in the pool (E, 3), and angles at the servos' shafts (E, J)."""
        q = self.swimmer.bodies.motion.q.numpy().copy()
        q[:, :2] += self._drift
        q[:, -1] = self.fin.shown(self.t, q[:, -1])
        return q[:, :3], q[:, 3:] - self._trim

    def rate(self) -> Array:
        """Joint rates in rad/s, shape (E, J)."""
        return np.array(self.swimmer.bodies.motion.v.numpy()[:, 3:])

    def stopped(self) -> NDArray[np.bool_]:
        """Boxes that the fluid's guard has stopped, shape (E,)."""
        return np.asarray(self.swimmer.fluid.stopped.numpy() >= 0)

    def step(self, sent: Array) -> None:
        """Send set-points in rad, shape (E, J), and advance by one control period."""
        t, bodies = self.t, self.swimmer.bodies
        self.servos.send(t, sent)
        for sub in range(self.swimmer.substeps):
            bodies.push(self._forces(t + sub * self.h))
            bodies.step()
            self._drift += self.h * self._flow(t + sub * self.h)
        self.swimmer.damp()
        self._periods += 1

    def swim(self, begin: Array, sent: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Swim commands from rest.

        Args:
            begin: Initial poses, shape (E, 3).
            sent: Set-points in rad of T control periods, shape (T, E, J).

        Returns:
            Poses (T, E, 3) and joint angles (T, E, J) as ``where`` gives them before each period,
            and the boxes that stopped, shape (E,).
        """
        self.reset(begin, np.zeros(sent.shape[1:]))
        poses, joints = [], []
        for row in sent:
            pose, joint = self.where()
            poses.append(pose)
            joints.append(joint)
            self.step(row)
        track = np.array(poses)
        speed = np.linalg.norm(np.diff(track[..., :2], axis=0), axis=2) / CONTROL_S
        stopped = self.stopped() | ~(speed.max(axis=0, initial=0.0) < WILD_M_S)
        return track, np.array(joints), stopped

    def _forces(self, t: float) -> Array:
        """Generalised forces on x, y, heading and joints of each robot, shape (E, 3 + J)."""
        motion = self.swimmer.bodies.motion
        q, v = motion.q.numpy(), motion.v.numpy()
        turn = q[:, 3:]
        torque = self.servos.torque(t, turn, v[:, 3:], self._trim)
        torque -= self._stiff * turn
        self._strain += self.h / self._relax * (turn - self._strain)
        torque -= self._soft * (turn - self._strain)
        torque -= self._damp * v[:, 3:]
        apart = np.diff(turn, axis=1)
        torque[:, :-1] += self._tied * apart
        torque[:, 1:] -= self._tied * apart
        torque[:, -1] = self.fin.torque(
            t, turn[:, -1], v[:, -1], torque[:, -1], self._drive(t, turn[:, -1], v[:, -1])
        )
        out = np.zeros(q.shape)
        out[:, 3:] = torque
        place = q[:, :2] + self._drift
        out[:, :2] += self._tether * (self._anchor - place)
        self.surfaces.add(out, q, v)
        self.waters.add(out, q, v, place, t)
        return out

    def _drive(self, t: float, turn: Array, rate: Array) -> Array:
        """Gains and target angles of the last servos: shape (3, E)."""
        target = self.servos.wanted(t)[:, -1] + self._trim[:, 0]
        return np.stack([self.servos.gains[0][:, -1], self.servos.gains[1][:, -1], target])

    def _flow(self, t: float) -> Array:
        """Velocity of the pool's water where the robots are, shape (E, 2).

        A neutrally buoyant body moves with it. A seiche of mode n has
        the frequency of long waves in a pool of this length and depth, omega^2 = g k tanh(k h).
        """
        flow = self._current.copy()
        speed, mode = self._seiche
        if speed.any():
            k = np.pi * mode / (2 * POOL_HALF_M)
            omega = np.sqrt(9.81 * k * np.tanh(k * DEPTH_M))
            size = speed * np.sin(omega * t)
            flow += size[:, None] * np.stack([np.cos(self._tilt), np.sin(self._tilt)], axis=1)
        return flow


def without_drag(robot: Robot) -> Robot:
    """The robot with appendages without drag: ``surfaces`` has the drag, the fluid the rest."""
    none = {"drag": (0.0, 0.0), "lateral_drag": (0.0, 0.0)}
    links = tuple(
        replace(link, appendages=tuple(replace(one, **none) for one in link.appendages))
        for link in robot.links
    )
    return replace(robot, links=links)


def _weighed(truth: Truth) -> dict[str, Any]:
    """Positions of the masses, for the rigid chain."""
    off = truth.effects.get("com_offset")
    return {"effects": [{"effect": "com_offset", "parameters": off}] if off else []}


@contextmanager
def _other_collision(magic: float) -> Iterator[None]:
    """Within this block fluids have other relaxation times; ``Swimmer`` has no option for them."""
    defaults = Fluid.__init__.__kwdefaults__ or {}
    known = defaults["magic"]
    defaults["magic"] = magic
    try:
        yield
    finally:
        defaults["magic"] = known
