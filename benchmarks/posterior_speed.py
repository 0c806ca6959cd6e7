"""How long the posterior of one servo takes: 32 walkers, 5000 steps, 30 s of data.

python benchmarks/posterior_speed.py
"""

from __future__ import annotations

import time
from pathlib import Path

from sim2real.model import FittedEffect, JointModel, read_model
from sim2real.posterior.servo import sample_servo
from sim2real.recording import read_recording
from sim2real.servo.trace import Trace, traces

ROOT = Path(__file__).parents[1]
DATA = ROOT / "datasets" / "servo_steps"
STEPS, WALKERS = 5000, 32
FRICTION = FittedEffect("coulomb_friction", {"torque_Nm": 0.005})


def main() -> None:
    """Print seconds on the clock and of the processor for each kind of servo."""
    model = read_model(ROOT / "reports" / "servo_steps" / "model.json").joints["j1"]
    rubbing = JointModel(
        model.kp_Nm_per_rad, model.kd_Nms_per_rad, model.latency_s, model.inertia_kgm2,
        load=model.load, effects=(FRICTION,),
    )  # fmt: skip
    for label, joint, names in (
        ("plain servo, steps", model, ("steps",)),
        ("plain servo, sine", model, ("sine",)),
        ("plain servo, three recordings", model, ("steps", "sine", "square")),
        ("with friction, steps", rubbing, ("steps",)),
    ):
        given = traces([read_recording(DATA / f"{name}.csv") for name in names], "j1")
        print(f"{label:<32}{measured(given, joint)}")


def measured(given: list[Trace], joint: JointModel) -> str:
    """Sample once to compile, then against the clock."""
    sample_servo(given, joint, steps=2, walkers=WALKERS)
    wall, cpu = time.perf_counter(), time.process_time()
    found = sample_servo(given, joint, steps=STEPS, walkers=WALKERS)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    rollouts = STEPS * WALKERS * len(given)
    return (
        f"{wall:6.1f} s ({cpu:.1f} s of processor), {rollouts / wall:7.0f} rollouts a second, "
        f"{found.convergence.spans:.0f} autocorrelation times"
    )


if __name__ == "__main__":
    main()
