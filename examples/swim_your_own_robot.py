# %% [markdown]
# # Swim your own robot
# A robot of four links, its normalised density, and a swim in the twin.

# %% tags=["parameters"]
OUT = "build/examples"

# %%
from pathlib import Path

import numpy as np

import sim2real as s2r
from sim2real.model import JointModel

# Mass in kg, length and width in m
LINKS = {
    "head": (0.4, 0.18, 0.11),
    "front": (0.2, 0.1, 0.09),
    "back": (0.1, 0.1, 0.05),
    "tail": (0.08, 0.1, 0.02),
}
JOINTS = ("j1", "j2", "j3")
out = Path(OUT)
out.mkdir(parents=True, exist_ok=True)

# %% [markdown]
# The robot as a file:

# %%
links = [
    f'[[links]]\nname = "{name}"\nmass_kg = {mass}\nlength_m = {length}\nwidth_m = {width}\n'
    "height_m = 0.1\n"
    for name, (mass, length, width) in LINKS.items()
]
joints = [
    f'[[joints]]\nname = "{name}"\nservo = "s"\nlimits_rad = [-0.8, 0.8]\n' for name in JOINTS
]
servo = "max_torque_Nm = 1.67\nno_load_speed_rad_s = 5.24\nposition_step_rad = 0.00419\n"
robot = out / "fish.toml"
robot.write_text("\n".join(['name = "my fish"\n', *links, *joints, f"[servos.s]\n{servo}"]))
print(s2r.density(robot))

# %% [markdown]
# A travelling wave on its joints, in the twin:

# %%
pd = JointModel(kp_Nm_per_rad=2.0, kd_Nms_per_rad=0.06, latency_s=0.06, inertia_kgm2=0.002)
model = s2r.Model(joints=dict.fromkeys(JOINTS, pd))
t = np.arange(0, 6, 0.02)
wave = np.sin(2 * np.pi * t[:, None] - 1.2 * np.arange(3)) * [0.3, 0.45, 0.6]
wave *= np.minimum(t, 1)[:, None]  # it begins at rest
commands = s2r.Recording("wave", "pool", JOINTS, t, wave, np.full_like(wave, np.nan))
swim = s2r.simulate(commands, robot, model, fidelity="twin")
print(swim)
figure = swim.plot()
figure.savefig(out / "way.png")
figure
