"""Let ``sim2real diagnose`` answer every case of a set, from its inputs alone.

python datasets/concealed/solve.py SET VERDICTS [--device cuda] [--first N] [--last N]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path

from sim2real.diagnose.diagnose import Case, diagnose_all
from sim2real.diagnose.result import Diagnosis, write_diagnosis
from sim2real.model import JointModel, Model, read_model, write_model
from sim2real.recording import read_recording
from sim2real.robot import read_robot

TOGETHER = 240
"""Cases whose simulations share their launches."""


def main() -> None:
    """Answer the cases and say how long each took."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("set", type=Path, metavar="SET")
    parser.add_argument("verdicts", type=Path, metavar="VERDICTS")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--last", type=int)
    options = parser.parse_args()
    folders = sorted((options.set / "inputs").iterdir())[options.first : options.last]
    start = time.perf_counter()
    for at in range(0, len(folders), TOGETHER):
        some = folders[at : at + TOGETHER]
        for folder, (found, plain) in zip(some, answers(some, options.device), strict=True):
            target = options.verdicts / folder.name
            target.mkdir(parents=True, exist_ok=True)
            write_diagnosis(found, target / "diagnosis.json", "enriched.json")
            write_model(found.model, target / "enriched.json")
            write_model(plain, target / "baseline.json")
        passed = time.perf_counter() - start
        print(f"{at + len(some)} cases, {passed:.0f} s", flush=True)


def answers(folders: Sequence[Path], device: str) -> list[tuple[Diagnosis, Model]]:
    """The diagnosis and the plain model of each case, against its references where it has some."""
    found = diagnose_all([_case(folder) for folder in folders], device=device)
    return [(one, plain_model(one)) for one in found]


def _case(folder: Path) -> Case:
    recordings, references = (
        [read_recording(path) for path in sorted(folder.glob(pattern))]
        for pattern in ("[abd-q]*.csv", "ref_*.csv")
    )
    given = folder / "model.json"
    model = read_model(given) if given.exists() else None
    return Case(recordings, read_robot(folder / "robot.toml"), model, references)


def plain_model(found: Diagnosis) -> Model:
    """The servos as fitted before anything was added."""
    assert found.baseline is not None
    joints: dict[str, JointModel] = dict(found.baseline.joints)
    return Model(joints=joints)


if __name__ == "__main__":
    main()
