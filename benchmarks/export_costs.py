"""What it costs that a simulator lacks an effect: servos, refitted for each target.

Servos of the library, and that of ``mujoco_agreement`` with play (``play``), also with dry friction
(``play_and_friction``), both of typical size.

    python -m benchmarks.export_costs [SERVO ...]

Prints a table in Markdown: RMS difference of the refitted servo from the whole model on the
standard excitation (steps, a chirp, a triangle), in brackets that of the servo with the effects
left out and nothing refitted, in mrad.
"""

from __future__ import annotations

import sys

from tqdm import tqdm

from benchmarks.mujoco_agreement import servo
from sim2real.commands.exports import TARGETS
from sim2real.exporters.expressible import expressible
from sim2real.model import Model
from sim2real.recording import Load
from sim2real.servo_library.catalogue import shipped

PLAY = {
    "play": servo(Load(0.002), "backlash"),
    "play_and_friction": servo(Load(0.002), "backlash", "coulomb_friction"),
}
SERVOS = ("xl330_gain800", "xl330_bam_m5", "mx64_bam_m1", "mx64_bam_m5", *PLAY)
SIMULATORS = ("mujoco", "mjlab", "isaaclab", "newton", "genesis", "urdf")


def cost(model: Model, target: str) -> str:
    """The cell of a servo and a target."""
    refits = expressible(model, TARGETS[target].expressed).refits
    if not refits:
        return "0"
    (refit,) = refits
    return f"{1e3 * refit.full_rad:.1f} ({1e3 * refit.dropped_rad:.1f})"


def main() -> None:
    """Print the table."""
    library = shipped()
    names = sys.argv[1:] or SERVOS
    known: dict[tuple[str, frozenset[str]], str] = {}
    print("| servo | " + " | ".join(SIMULATORS) + " |\n|---" + "|---" * len(SIMULATORS) + "|")
    for name in tqdm(names, disable=None):
        model, cells = PLAY[name] if name in PLAY else library[name].model, []
        (joint,) = model.joints.values()
        for target in SIMULATORS:
            has = frozenset(TARGETS[target].expressed(joint)) - {"latency_jitter"}
            if (name, has) not in known:
                known[name, has] = cost(model, target)
            cells.append(known[name, has])
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
