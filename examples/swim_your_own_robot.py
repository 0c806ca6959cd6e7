"""A robot of four links written down, its mass looked at, and swum in the twin."""

import argparse
from pathlib import Path

import numpy as np

import sim2real as s2r
from sim2real.model import JointModel

LINKS = {"head": (0.4, 0.18, 0.11), "front": (0.2, 0.1, 0.09), "back": (0.1, 0.1, 0.05)}
"""Mass in kg, length and width in m."""
JOINTS = ("j1", "j2", "j3")


def main() -> None:
    """Write the robot, swim it, draw its way."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("build/examples"))
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    robot = out / "fish.toml"
    robot.write_text(described())
    print(s2r.density(robot))

    servo = JointModel(kp_Nm_per_rad=2.0, kd_Nms_per_rad=0.06, latency_s=0.06, inertia_kgm2=0.002)
    model = s2r.Model(joints=dict.fromkeys(JOINTS, servo))
    t = np.arange(0, 6, 0.02)
    wave = np.sin(2 * np.pi * t[:, None] - 1.2 * np.arange(3)) * [0.3, 0.45, 0.6]
    wave *= np.minimum(t, 1)[:, None]  # it begins at rest
    commands = s2r.Recording("wave", "pool", JOINTS, t, wave, np.full_like(wave, np.nan))
    swum = s2r.simulate(commands, robot, model, fidelity="twin")
    print(swum)
    swum.plot().savefig(out / "way.png")


def described() -> str:
    """The robot as ``robot.toml`` says it."""
    sizes = {**LINKS, "tail": (0.08, 0.1, 0.02)}
    links = [
        f'[[links]]\nname = "{name}"\nmass_kg = {mass}\nlength_m = {length}\nwidth_m = {width}\n'
        "height_m = 0.1\n"
        for name, (mass, length, width) in sizes.items()
    ]
    joints = [
        f'[[joints]]\nname = "{name}"\nservo = "s"\nlimits_rad = [-0.8, 0.8]\n' for name in JOINTS
    ]
    servo = "max_torque_Nm = 1.67\nno_load_speed_rad_s = 5.24\nposition_step_rad = 0.00419\n"
    return "\n".join(['name = "my fish"\n', *links, *joints, f"[servos.s]\n{servo}"])


if __name__ == "__main__":
    main()
