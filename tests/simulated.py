"""One joint whose parameters are known, as recorded: a servo, its noise, its gaps."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from sim2real import predict
from sim2real.model import FittedEffect, JointModel
from sim2real.recording import Load, Recording, read_recording
from sim2real.robot import Joint, Link, Robot, Servo
from sim2real.servo.parameters import COLUMNS, joint_row
from sim2real.servo.rollout import rollout
from sim2real.servo.trace import trace

BENCH = Path(__file__).parents[1] / "datasets" / "servo_steps"
KP, KD, LATENCY, INERTIA = 2.2, 0.06, 0.05, 0.002
PERIOD, NOISE = 0.02, 0.0015
SHEET = Servo("lx824", 1.67, 5.24, 0.00419)
FRICTION = {"coulomb_friction": {"torque_Nm": 0.05}}


def steps(t, rng, largest=0.6):
    """Set-points that step to a new level every half second or so, from rest at 0."""
    moves = 0.5 + np.cumsum(np.concatenate([[0.0], rng.uniform(0.3, 0.9, t.size)]))
    levels = np.concatenate([[0.0], rng.uniform(-largest, largest, t.size + 1)])
    return levels[np.searchsorted(moves, t, side="right")]


def row(load=None, **effects):
    """Parameters of the servo with these effects, shape (P,)."""
    fitted = tuple(FittedEffect(name, values) for name, values in effects.items())
    return joint_row(JointModel(KP, KD, LATENCY, INERTIA, effects=fitted), load)


def column(name):
    return COLUMNS.index(name)


def one_joint(t, command, angle, load=Load(INERTIA), name="steps"):  # noqa: B008
    """A recording of joint j1 with these set-points and angles (T,)."""
    loads = {"j1": load} if load else {}
    return Recording(name, "servo", ("j1",), t, command[:, None], angle[:, None], loads)


def beside(first, second, names=("j1", "j2")):
    """The joints of two recordings as two joints of one."""
    pair = (first, second)
    command = np.hstack([one.command for one in pair])
    position = np.hstack([one.position for one in pair])
    loads = {name: one.loads["j1"] for name, one in zip(names, pair, strict=True)}
    return replace(first, joints=names, command=command, position=position, loads=loads)


def recording(seed=0, name="steps", seconds=12.0, noise=NOISE, load=None, command=None, **effects):
    """What a sensor with white noise sees of the servo."""
    rng = np.random.default_rng(seed)
    t = PERIOD * np.arange(round(seconds / PERIOD))
    sent = steps(t, rng) if command is None else command(t)
    load = load or Load(INERTIA)
    angle = rollout(row(load, **effects)[None], t, sent)[0]
    return one_joint(t, sent, angle + rng.normal(0, noise, t.size), load, name)


def traced(seed=0, name="steps", **given):
    """The same, ready to be fitted."""
    return trace(recording(seed, name, **given), "j1")


def two(**effects):
    """Two recordings of eight seconds: enough to name what is missing."""
    return [recording(1, "a", seconds=8.0, **effects), recording(2, "b", seconds=8.0, **effects)]


def robot(*names, servo=SHEET, limits=(-1.0, 1.0)):
    """A bench of such joints."""
    joints = tuple(Joint(name, servo, limits) for name in names)
    return Robot("bench", (Link("link", 0.1, 0.1, 0.1, 0.1),) * (len(names) + 1), joints)


def linear_bench(model, noise=2e-3):
    """Eight seconds of the shipped steps, recorded on linear servos with the gains of a model.

    Returns:
        The recording, and the model of these servos.
    """
    joints = {n: replace(j, law="pd", motor={}, interval={}) for n, j in model.joints.items()}
    linear = replace(model, joints=joints)
    shipped = read_recording(BENCH / "steps.csv").between(0, 400)
    white = np.random.default_rng(0).normal(0.0, noise, shipped.position.shape)
    return replace(shipped, position=predict(shipped, None, linear).angles[0] + white), linear
