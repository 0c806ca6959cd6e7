"""Swims that ship: thirty seconds each of a robot in a pool of its own, something concealed.

    python datasets/pool/make.py OUT [--device cuda:0] [--cell-m 0.005] [--seconds 30]

A surrogate of reality, and simulated, not measured. The water is the lattice-Boltzmann fluid in
cells of half the size, with another sub-grid model and another collision than what is calibrated.
Everything else is of its own: servos, friction, skin, tether, rough surfaces and the camera are
written here in NumPy, on slack joints, and share no code with the library's laws. Truth goes into
``truth.json``, which no fit may read.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from tqdm import tqdm

from sim.fluid import Fluid
from sim.swimmer import CONTROL_S, Swimmer
from sim2real.model import JointModel, Model
from sim2real.recording import Recording, write_recording
from sim2real.robot import read_robot

HERE = Path(__file__).parent
VISCOSITY_M2_S = 4e-5
SMAGORINSKY, MAGIC = 0.14, 1e-2
"""The library's fluid uses 0.1 and 3/16."""
NOISE = {"position_m": 0.002, "heading_rad": 0.009, "joint_rad": 0.0015}
STEP_RAD = 0.00419


@dataclass(frozen=True)
class Truth:
    """One recording's world; SI.

    Attributes:
        name: Of the file.
        effects: What is concealed: identifier and parameters.
        kp, kd, latency: Of the three servos.
    """

    name: str
    effects: dict[str, dict[str, float]] = field(default_factory=dict)
    kp: tuple[float, ...] = (2.1, 2.0, 1.9)
    kd: tuple[float, ...] = (0.075, 0.07, 0.066)
    latency: tuple[float, ...] = (0.062, 0.066, 0.071)


WORLDS = (
    Truth("clean", kp=(2.3, 1.85, 2.05), kd=(0.068, 0.077, 0.06), latency=(0.066, 0.062, 0.074)),
    Truth("p1", {"skin_viscoelasticity": {"stiffness_Nm_per_rad": 0.9, "relaxation_s": 0.4}}),
    Truth("p2", {"surface_friction.rubber": {"coefficient": 0.06}}),
    Truth("p3", {"pool_current": {"u_m_s": 0.03, "v_m_s": -0.02}}),
    Truth("p4", {"camera_latency": {"latency_s": 0.12}}),
    Truth(
        "p5",
        {
            "trim_asymmetry": {"offset_rad": 0.09},
            "skin_elasticity": {"stiffness_Nm_per_rad": 0.7},
        },
    ),
    Truth(
        "p6",
        {
            "tether": {"stiffness_N_per_m": 0.25, "x_m": 0.3, "y_m": 0.8},
            "camera_rotation": {"angle_rad": 0.12},
        },
    ),
)


def command(t: float, joints: int, phase: float) -> np.ndarray:
    """Set-points: a wave, the paper's square in all joints, a wave that turns; rad."""
    lag = 1.2 * np.arange(joints)
    size = np.array([0.30, 0.45, 0.60])
    if t < 0.5:
        return np.zeros(joints)
    if t < 12:
        return min(1.0, t - 0.5) * size * np.sin(2 * np.pi * t - lag + phase)
    if t < 18:
        return np.full(joints, 0.52 * np.sign(np.sin(2 * np.pi * 0.5 * (t - 12))))
    bias = 0.25 * np.sin(2 * np.pi * (t - 18) / 12 + phase)
    return np.clip(0.8 * size * np.sin(2 * np.pi * 1.3 * t - lag) + bias, -0.78, 0.78)


class World:
    """All recordings at once, one box each."""

    def __init__(self, device: str, cell_m: float, seed: int) -> None:
        self.robot = read_robot(HERE / "robot.toml")
        J = len(self.robot.joints)
        slack = JointModel(1e-12, 0.0, 0.0, 0.001)
        model = Model(joints={joint.name: slack for joint in self.robot.joints})
        Fluid.__init__.__kwdefaults__["magic"] = MAGIC
        self.swimmer = Swimmer(
            self.robot, model, n_envs=len(WORLDS), cell_m=cell_m, device=device,
            viscosity_m2_s=VISCOSITY_M2_S, smagorinsky=SMAGORINSKY,
            substeps=max(32, 2 * int(np.ceil(CONTROL_S * 1.4 / 0.15 / cell_m / 2))), threads=2,
        )  # fmt: skip
        self.h = CONTROL_S / self.swimmer.substeps
        self.rng = np.random.default_rng(seed)
        self.kp, self.kd, self.latency = (
            np.array([getattr(world, key) for world in WORLDS]) for key in ("kp", "kd", "latency")
        )
        self.sent: list[tuple[float, np.ndarray]] = []
        self.strain = np.zeros((len(WORLDS), J))
        q, v = (
            x.numpy().copy() for x in (self.swimmer.bodies.motion.q, self.swimmer.bodies.motion.v)
        )
        q[:, 3:] = self.value("trim_asymmetry", "offset_rad")[:, None]
        current = self.current()
        v[:, :2] = -current
        self.swimmer.bodies.place(q, v)

    def value(self, effect: str, name: str) -> np.ndarray:
        """A parameter of each world, 0 where it has no such effect."""
        return np.array([world.effects.get(effect, {}).get(name, 0.0) for world in WORLDS])

    def current(self) -> np.ndarray:
        """Velocity of the water in each world, shape (worlds, 2)."""
        return np.stack([self.value("pool_current", n) for n in ("u_m_s", "v_m_s")], axis=1)

    def forces(self, t: float) -> np.ndarray:
        """Generalised forces on x, y, heading and joints of each world."""
        motion = self.swimmer.bodies.motion
        q, v = motion.q.numpy(), motion.v.numpy()
        E, N = q.shape
        out = np.zeros((E, N))
        turn, rate = q[:, 3:], v[:, 3:]
        trim = self.value("trim_asymmetry", "offset_rad")[:, None]
        wanted = np.zeros_like(turn)
        for e in range(E):
            for k in range(turn.shape[1]):
                here = [u[e, k] for at, u in self.sent if at + self.latency[e, k] <= t]
                wanted[e, k] = here[-1] if here else 0.0
        torque = self.kp * (wanted + trim - turn) - self.kd * rate
        torque -= 0.004 * np.tanh(rate / 0.1)  # every servo has a little friction
        torque -= self.value("skin_elasticity", "stiffness_Nm_per_rad")[:, None] * turn
        time = np.maximum(self.value("skin_viscoelasticity", "relaxation_s")[:, None], 1e-3)
        self.strain += self.h / time * (turn - self.strain)
        soft = self.value("skin_viscoelasticity", "stiffness_Nm_per_rad")[:, None]
        torque -= soft * (turn - self.strain)
        out[:, 3:] = torque
        drift = self.current() * t
        k = self.value("tether", "stiffness_N_per_m")
        anchor = np.stack([self.value("tether", n) for n in ("x_m", "y_m")], axis=1)
        out[:, :2] += k[:, None] * (anchor - drift - q[:, :2])
        self._rough(out, q, v)
        return out

    def _rough(self, out: np.ndarray, q: np.ndarray, v: np.ndarray) -> None:
        """Friction along the links of rubber, at their middles, by the chain's own geometry."""
        rough = self.value("surface_friction.rubber", "coefficient")
        if not rough.any():
            return
        hull = self.swimmer.hull
        com0 = float(self.swimmer.bodies.chain.com.numpy()[0, 0])
        around = np.pi * (hull.half_width + hull.half_height).mean(axis=1)
        for e in np.flatnonzero(rough):
            heading = q[e, 2]
            pivot = q[e, :2] + com0 * np.array([np.cos(heading), np.sin(heading)])
            pivots = []
            for k, link in enumerate(self.robot.links):
                if k:
                    heading += q[e, 2 + k]
                    pivots.append(pivot.copy())
                axis = np.array([np.cos(heading), np.sin(heading)])
                middle = pivot - 0.5 * hull.length[k] * axis
                if link.material == "rubber":
                    arms = [q[e, :2], *pivots]
                    rates = [v[e, 2], *v[e, 3 : 3 + k]]
                    speed = v[e, :2] + sum(
                        w * np.array([-(middle - a)[1], (middle - a)[0]])
                        for a, w in zip(arms, rates, strict=True)
                    )
                    along = float(speed @ axis)
                    push = -0.5 * 1000 * around[k] * hull.length[k] * rough[e] * along * abs(along)
                    force = push * axis
                    out[e, :2] += force
                    for i, a in enumerate(arms):
                        r = middle - a
                        out[e, 2 + i] += r[0] * force[1] - r[1] * force[0]
                pivot = pivot - hull.length[k] * axis

    def step(self, t: float, sent: np.ndarray) -> None:
        """One control period."""
        self.sent.append((t, sent))
        self.sent = self.sent[-12:]
        for sub in range(self.swimmer.substeps):
            self.swimmer.bodies.push(self.forces(t + sub * self.h))
            self.swimmer.bodies.step()
        self.swimmer._sponge()


def seen(world: Truth, t: np.ndarray, pose: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """What the camera says, shape (T, 3)."""
    late = world.effects.get("camera_latency", {}).get("latency_s", 0.0)
    shown = np.stack([np.interp(t - late, t, column) for column in pose.T], axis=1)
    angle = world.effects.get("camera_rotation", {}).get("angle_rad", 0.0)
    c, s = np.cos(angle), np.sin(angle)
    shown[:, :2] = shown[:, :2] @ np.array([[c, s], [-s, c]])
    shown[:, :2] += NOISE["position_m"] * rng.standard_normal((t.size, 2))
    shown[:, 2] += NOISE["heading_rad"] * rng.standard_normal(t.size)
    return shown


def main() -> None:
    """Swim, film, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--cell-m", type=float, default=0.005)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--seed", type=int, default=20261121)
    options = parser.parse_args()
    world = World(options.device, options.cell_m, options.seed)
    J, E = len(world.robot.joints), len(WORLDS)
    phases = world.rng.uniform(-0.5, 0.5, E)
    times = CONTROL_S * np.arange(round(options.seconds / CONTROL_S))
    sent, pose, joint = [], [], []
    for t in tqdm(times, desc="pool", disable=None):
        motion = world.swimmer.bodies.motion
        q = motion.q.numpy().copy()
        q[:, :2] += world.current() * t
        pose.append(q[:, :3])
        joint.append(q[:, 3:] - world.value("trim_asymmetry", "offset_rad")[:, None])
        sent.append(np.array([command(t, J, phase) for phase in phases]))
        world.step(t, sent[-1])
    stopped = world.swimmer.fluid.stopped.numpy()
    if (stopped >= 0).any():
        raise SystemExit(f"boxes stopped: {np.flatnonzero(stopped >= 0).tolist()}")
    for e, one in enumerate(WORLDS):
        shown = seen(one, times, np.array(pose)[:, e], world.rng)
        angle = np.array(joint)[:, e] + NOISE["joint_rad"] * world.rng.standard_normal(
            (times.size, J)
        )
        recording = Recording(
            name=one.name, kind="pool", joints=tuple(j.name for j in world.robot.joints),
            t=times, command=np.array(sent)[:, e], position=np.round(angle / STEP_RAD) * STEP_RAD,
            medium="water",
            source="Simulated, not measured: datasets/pool/make.py. MIT licence.",
            columns={f"body.{n}": shown[:, i] for i, n in enumerate(("x_m", "y_m", "yaw_rad"))},
        )  # fmt: skip
        write_recording(recording, options.out / f"{one.name}.csv")
    truth = {
        "seed": options.seed, "cell_m": options.cell_m, "viscosity_m2_s": VISCOSITY_M2_S,
        "noise": NOISE, "worlds": [asdict(one) for one in WORLDS],
    }  # fmt: skip
    (options.out / "truth.json").write_text(json.dumps(truth, indent=1) + "\n")


if __name__ == "__main__":
    main()
