"""A servo with dry friction, made here, and what the diagnosis says that its model lacks."""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

import sim2real as s2r
from sim2real.model import FittedEffect

DATA = Path("datasets/servo_steps")
NOISE_RAD = 0.001


def main() -> None:
    """Make recordings of a servo that rubs, then diagnose them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("build/examples"))
    parser.add_argument("--friction", type=float, default=0.08, help="N m (default 0.08)")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)

    robot, rng = s2r.read_robot(DATA / "robot.toml"), np.random.default_rng(0)
    recordings = [only_first(s2r.read_recording(DATA / f"{n}.csv")) for n in ("steps", "chirp")]
    plain = s2r.identify(recordings, robot)
    friction = FittedEffect("coulomb_friction", {"torque_Nm": options.friction})
    rubbing = replace(plain, joints={"j1": replace(plain.joints["j1"], effects=(friction,))})
    angles = s2r.predict(recordings, robot, rubbing).angles
    made = [
        replace(one, position=angle + NOISE_RAD * rng.standard_normal(angle.shape), path=None)
        for one, angle in zip(recordings, angles, strict=True)
    ]
    found = s2r.diagnose(made, robot)
    print(found)
    found.plot().savefig(options.out / "candidates.png")


def only_first(recording: s2r.Recording) -> s2r.Recording:
    """Ten seconds of the first joint alone."""
    one = recording.between(0, 500)
    return replace(one, joints=("j1",), command=one.command[:, :1], position=one.position[:, :1])


if __name__ == "__main__":
    main()
