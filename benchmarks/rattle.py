r"""From which peak of a residual's spectrum on does a joint rattle, and how large is the rattle?

    python datasets/foreign/make_foreign.py SET --seed 64 --no-oracle --null 40 \
        --single 0 --double 0 --outside 0
    python datasets/foreign/make_foreign.py PLAY --seed 65 --no-oracle --plants hobby --null 0 \
        --single 24 --double 0 --outside 0 --effects backlash_rattling
    python -m benchmarks.rattle SET PLAY

Fits ``identify`` to every case and prints, of servos in which nothing is missing, the largest
ratios of a peak that is no motion's (a check of the chosen ``report.rattle_ratio``), and of
gears with play and without friction the ratio, and the rattle's size relative to the gap.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import command_line, spread
from sim2real.diagnose.located import rattle
from sim2real.identification.identify import identify
from sim2real.recording import read_recording
from sim2real.robot import read_robot
from sim2real.servo.prediction import predict_recordings


def examined(job: tuple[Path, dict[str, Any]]) -> dict[str, Any]:
    """Each joint's ratio, the rattle's standard deviation, and the true gap."""
    folder, answer = job
    case = folder / "inputs" / answer["case"]
    recordings = [read_recording(case / f"{name}.csv") for name in ("a", "b")]
    model = identify(recordings, read_robot(case / "robot.toml"))
    angles = predict_recordings(recordings, model).angles
    errors = [y - r.position for y, r in zip(angles, recordings, strict=True)]
    true = {e["component"]: e["parameters"]["gap_rad"] for e in answer["effects"]}
    rows = []
    for j, joint in enumerate(recordings[0].joints):
        found = rattle([r.t for r in recordings], [e[:, j] for e in errors], least=0.0)
        ratio, sd = (found.ratio, found.sd_rad) if found else (0.0, 0.0)
        rows.append([ratio, sd, true.get(joint, 0.0)])
    return {"case": answer["case"], "rows": rows}


def main() -> None:
    """Fit all cases, print both lists."""
    parser = command_line(__doc__, processes=2)
    parser.add_argument("sets", nargs="+", type=Path, metavar="SET")
    options = parser.parse_args()
    jobs = [
        (folder, answer)
        for folder in options.sets
        for answer in json.loads((folder / "answers.json").read_text())
    ]
    rows = np.array([r for x in spread(examined, jobs, options.processes) for r in x["rows"]])
    still, play = rows[rows[:, 2] == 0], rows[rows[:, 2] > 0]
    print(f"{len(still)} joints without play, largest ratios:", np.sort(still[:, 0])[-6:].round(2))
    for ratio, sd, true in play[np.argsort(play[:, 2])]:
        print(f"gap {true:.4f} rad: ratio {ratio:5.1f}, rattle over gap {sd / true:.3f}")


if __name__ == "__main__":
    main()
