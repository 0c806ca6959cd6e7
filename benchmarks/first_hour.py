"""How long the first hour's two commands take: identify and diagnose on new benches, in A and s.

python -m benchmarks.first_hour [--benches 50] [--kind single] [--seed S]

A is the time of ten million additions in a Python loop, taken in the same minute: machines differ,
and so does what else they are doing. A bench has three servos of ``datasets/foreign`` and two
recordings of 30 s at 50 Hz; with ``--kind outside`` what is hidden is in no catalogue, so that
nothing fits, and the search goes farthest. Needs ``pip install mujoco numba``.
"""

from __future__ import annotations

import json
import resource
import secrets
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from unittest import mock

import numpy as np

from benchmarks.harness import ROOT, command_line, seconds_per_ten_million_additions

sys.path[:0] = [str(ROOT / "datasets" / name) for name in ("foreign", "concealed")]

RATE_HZ, DURATION_S = 50.0, 30.0
GIVEN = ("a.csv", "b.csv")
KINDS = ("single", "double", "outside", "null")


def main() -> None:
    """Draw the benches, run both commands on each, print the table."""
    parser = command_line(
        __doc__, benches=3, seed=(int, "of the benches; by default the system draws one"),
        in_process=(False, "without the process's start"),
    )  # fmt: skip
    parser.add_argument("--kind", choices=KINDS, default="single", help="what is hidden")
    options = parser.parse_args()
    seed = secrets.randbits(32) if options.seed is None else options.seed
    print(f"{options.benches} benches ({options.kind}), seed {seed}")
    work = in_process if options.in_process else by_command
    spent: dict[str, list[tuple[float, float]]] = {"identify": [], "diagnose": []}
    with tempfile.TemporaryDirectory() as folder:
        cases = draw(Path(folder), options.kind, options.benches, seed)
        for what in spent:
            work(what, cases[0])  # compiles kernels, once for all
        for case in cases:
            additions = seconds_per_ten_million_additions(1)
            words = [f"A = {additions:.3f} s"]
            for what, every in spent.items():
                before, start = processor_s(), time.perf_counter()
                work(what, case)
                seconds = time.perf_counter() - start
                every.append((seconds, seconds / additions))
                times = f"{seconds:.2f} s ({processor_s() - before:.2f} s of processors)"
                words.append(f"{what} {times} = {seconds / additions:.1f} A")
            print(f"{case.name}: {', '.join(words)}; {verdict(case)}", flush=True)
    for what, every in spent.items():
        seconds, multiples = np.array(every).T
        print(
            f"{what}: median {np.median(seconds):.2f} s = {np.median(multiples):.1f} A,"
            f" worst {seconds.max():.2f} s = {multiples.max():.1f} A"
        )


def draw(folder: Path, kind: str, count: int, seed: int) -> list[Path]:
    """Folders of benches of three servos, made by the generator of ``datasets/foreign``."""
    import foreign_cases
    import foreign_servos
    from files import write_case
    from make_foreign import plan

    counts = {name: count if name == kind else 0 for name in KINDS}
    jobs = plan(counts, np.random.default_rng(seed))
    with (
        mock.patch.object(foreign_servos, "BENCHES", (0.0, 0.0, 1.0)),
        mock.patch.object(foreign_cases, "RATE_HZ", (RATE_HZ, RATE_HZ)),
        mock.patch.object(foreign_cases, "ROWS", RATE_HZ * DURATION_S),
    ):
        for k, (plant, what, name) in enumerate(jobs):
            case = foreign_cases.draw_case(plant, what, name, np.random.default_rng([seed, k]))
            write_case(case, f"bench_{k + 1:02d}", folder)
    return sorted((folder / "inputs").iterdir())


def processor_s() -> float:
    """Time on processors of this process and of those that it has started, s."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def by_command(what: str, case: Path) -> None:
    """The command in a process of its own, its page and plots left out."""
    files = [str(case / name) for name in GIVEN]
    rest = ["--robot", str(case / "robot.toml"), "--out", str(case / f"{what}.json")]
    quiet = "--no-plots" if what == "identify" else "--no-page"
    command = [sys.executable, "-m", "sim2real", what, *files, *rest, quiet]
    subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=True)


def in_process(what: str, case: Path) -> None:
    """The function that the command calls."""
    from sim.commands.diagnose import write_all
    from sim2real.diagnose.diagnose import diagnose
    from sim2real.identification.identify import identify
    from sim2real.recording import read_recording
    from sim2real.robot import read_robot

    recordings = [read_recording(case / name) for name in GIVEN]
    robot = read_robot(case / "robot.toml")
    if what == "identify":
        identify(recordings, robot)
    else:
        write_all(diagnose(recordings, robot), case / "diagnose.json")


def verdict(case: Path) -> str:
    """What the diagnosis said, and whether its budget ended the search."""
    content = json.loads((case / "diagnose.json").read_text())
    complete = content["search"]["complete"]
    return f"{content['verdict']}{'' if complete else ', search ended by its budget'}"


if __name__ == "__main__":
    main()
