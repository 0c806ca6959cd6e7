# %% [markdown]
# # Find what is missing
# A servo with dry friction, made here, and what the diagnosis says that its model lacks.

# %% tags=["parameters"]
OUT = "build/examples"
FRICTION_NM = 0.08

# %%
from dataclasses import replace
from pathlib import Path

import numpy as np

import sim2real as s2r
from sim2real.example import BENCH
from sim2real.model import FittedEffect

NOISE_RAD = 0.001
out = Path(OUT)
out.mkdir(parents=True, exist_ok=True)


# %% [markdown]
# Ten seconds of the first joint alone, replayed by a servo with friction:


# %%
def only_first(recording: s2r.Recording) -> s2r.Recording:
    """Ten seconds of the first joint alone."""
    one = recording.between(0, 500)
    return replace(one, joints=("j1",), command=one.command[:, :1], position=one.position[:, :1])


robot, rng = s2r.read_robot(BENCH / "robot.toml"), np.random.default_rng(0)
recordings = [only_first(s2r.read_recording(BENCH / f"{n}.csv")) for n in ("steps", "chirp")]
plain = s2r.identify(recordings, robot)
friction = FittedEffect("coulomb_friction", {"torque_Nm": FRICTION_NM})
rubbing = replace(plain, joints={"j1": replace(plain.joints["j1"], effects=(friction,))})
angles = s2r.predict(recordings, robot, rubbing).angles
made = [
    replace(one, position=angle + NOISE_RAD * rng.standard_normal(angle.shape), path=None)
    for one, angle in zip(recordings, angles, strict=True)
]

# %% [markdown]
# The diagnosis sees these recordings alone:

# %%
found = s2r.diagnose(made, robot)
print(found)
figure = found.plot()
figure.savefig(out / "candidates.png")
figure
