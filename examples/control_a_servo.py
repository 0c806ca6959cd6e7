# %% [markdown]
# # Control a servo with its model
# Model-predictive control of a servo near its no-load speed, once with the identified servo and
# once with a plain PD model of the same recordings. IPOPT finds the set-points, with derivatives of
# the exported servo.

# %% tags=["parameters"]
OUT = "build/examples"
FRICTION_NM = 0.05
SECONDS = 2.0

# %%
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np

import sim2real as s2r
from sim2real.example import BENCH
from sim2real.model import FittedEffect, JointModel
from sim2real.servo.prediction import predict

NOISE_RAD, PERIOD_S, HORIZON = 0.001, 0.02, 15
out = Path(OUT)
out.mkdir(parents=True, exist_ok=True)


# %% [markdown]
# The servo to control has a torque-speed line and dry friction. Two models are identified from what
# it does on the commands of two recordings:


# %%
friction = FittedEffect("coulomb_friction", {"torque_Nm": FRICTION_NM})
line = {"stall_torque_Nm": 1.6, "no_load_speed_rad_s": 5.4}
joint = JointModel(1.4, 0.07, 3 * PERIOD_S, 0.0022, law="motor", motor=line, effects=(friction,))
true = s2r.Model({"j1": joint})
robot, made, rng = s2r.read_robot(BENCH / "robot.toml"), [], np.random.default_rng(0)
for name in ("steps", "chirp"):  # ten seconds of the first joint alone
    sent = s2r.read_recording(BENCH / f"{name}.csv").between(0, 500)
    one = replace(sent, joints=("j1",), command=sent.command[:, :1], path=None)
    angle = predict(true, one.t, {"j1": one.command[:, 0]})["j1"]
    seen = angle + NOISE_RAD * rng.standard_normal(angle.size)
    made.append(replace(one, position=seen[:, None]))
models = {
    "true": true,
    "plain": s2r.identify(made, robot, law="pd"),
    "servo": s2r.identify(made, robot, law="motor", effects="coulomb_friction"),
}


# %% [markdown]
# Each becomes a function of CasADi: state, set-point and parameters to the next state. With sharp
# friction, a servo at rest does not answer to small changes of its set-point, and IPOPT has no
# slope to follow: the models of the controller are rounded off more than the servo that it moves.


# %%
def exported(name: str, smoothing: float) -> ca.Function:
    """The state after one period, from the state and the set-point in force."""
    target = out / f"{name}.casadi"
    s2r.export(models[name], "casadi", target)
    servo = ca.Function.load(str(target))
    x, u = ca.MX.sym("x", 2), ca.MX.sym("u")
    half = {"set_point": u, "duration_s": PERIOD_S / 2, "smoothing": smoothing}  # at most 10 ms
    middle = servo(state=x, **half)["next_state"]
    return ca.Function("period", [x, u], [servo(state=middle, **half)["next_state"]]).expand()


steps = {name: exported(name, 1e-3 if name == "true" else 0.1) for name in models}


# %% [markdown]
# The controller sees angle and speed. A set-point that it sends now acts three periods later: it
# predicts the state until then from the set-points on their way, and plans from there.


# %%
def wanted(t: np.ndarray) -> np.ndarray:
    """Angle in rad: a sine of 0.5 rad and 1.4 Hz that starts gently."""
    return 0.5 * np.minimum(t / 0.5, 1.0) * np.sin(2 * np.pi * 1.4 * t)


def controller(step: ca.Function) -> ca.Function:
    """State, set-points on their way, wanted angles, and the last plan, to the new plan."""
    opti = ca.Opti()
    x, u = opti.variable(2, HORIZON + 1), opti.variable(1, HORIZON)
    now, sent, aim = opti.parameter(2), opti.parameter(3), opti.parameter(1, HORIZON)
    start = now
    for k in range(3):
        start = step(start, sent[k])
    opti.subject_to(x[:, 0] == start)
    opti.subject_to(x[:, 1:] == step.map(HORIZON)(x[:, :-1], u))
    opti.subject_to(opti.bounded(-1.2, u, 1.2))
    moves = ca.diff(ca.horzcat(sent[2], u), 1, 1)
    opti.minimize(ca.sumsqr(x[0, 1:] - aim) + 1e-4 * ca.sumsqr(moves))
    opti.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes"})
    return opti.to_function("plan", [now, sent, aim, x, u], [x, u])


def controlled(model: str) -> tuple[np.ndarray, np.ndarray]:
    """Set-points sent and angles reached, in rad, of the true servo."""
    plan, state, sent = controller(steps[model]), np.zeros(2), [0.0] * 3
    x, u = np.zeros((2, HORIZON + 1)), np.zeros((1, HORIZON))
    reached = []
    for k in range(t.size):
        reached.append(float(state[0]))
        aim = wanted(PERIOD_S * (k + 4 + np.arange(HORIZON)))
        x, u = plan(state, sent[-3:], aim[None], x, u)
        sent.append(float(u[0]))
        state = np.asarray(steps["true"](state, sent[-4]))[:, 0]
    return np.array(sent[3:]), np.array(reached)


# %%
t = PERIOD_S * np.arange(round(SECONDS / PERIOD_S))
runs = {name: controlled(name) for name in ("plain", "servo")}
for name, (_, reached) in runs.items():
    error = 1e3 * np.sqrt(np.mean((reached - wanted(t)) ** 2))
    print(f"{name}: {error:.1f} mrad RMS from the wanted angle")

# %% [markdown]
# `predict`, which has friction and limits as they are, on the set-points that were sent:

# %%
for name, (sent, reached) in runs.items():
    before = np.r_[t[0] - PERIOD_S, t], {"j1": np.r_[0.0, sent]}  # at rest
    apart = predict(true, *before)["j1"][1:] - reached
    print(f"{name}: at most {1e3 * np.abs(apart).max():.2f} mrad from the angles reached")
