"""Make a sealed set of swims: *find what the robot's simulator leaves out*.

    python datasets/pool/sealed.py OUT [--device cuda:0,cuda:1] [--processes 8] [--seconds-left S]

Each case is a swim of 20 s with something concealed in it, or nothing; most come with two swims of
the same robot in the same water in which nothing is. A grader keeps another swim with the same
concealed, and the answers. Robots, servos, waters, cameras and commands are drawn. A process makes
one robot's cases, all in one batch of boxes; what is made is kept, so a run that was stopped goes
on where it was.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import multiprocessing
import secrets
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numpy as np
from camera import reported, seen
from drawn import (
    LEAST_M,
    NOMINAL,
    SECONDS,
    Case,
    Drawn,
    case_of,
    command_of,
    plan,
    robot_of,
    start_of,
)
from knower import known_to
from numpy.typing import NDArray
from truth import Truth
from world import World

from sim.robot.swimmer import CONTROL_S
from sim2real.appendages import Appendage
from sim2real.model import read_model, write_model
from sim2real.recording import Recording, write_recording

Array = NDArray[np.float64]

COUNTS = {"null": 34, "single": 56, "double": 24, "outside": 24}
ROBOTS = 8
REFERENCES = 2
SOURCE = "Simulated, not measured: datasets/pool/sealed.py. MIT licence."
NUDGE_M = 1e-3
"""Distance by which another box begins elsewhere, for another, unpredictable wake."""


def made(
    seed: int, robots: int, k: int, counts: dict[str, int], singles: Sequence[str] = ()
) -> tuple[Drawn, list[Case], Any, int]:
    """Robot ``k``, its cases, the generator of what else is drawn, and cases of earlier robots."""
    order, *streams = np.random.SeedSequence(seed).spawn(1 + robots)
    rng = np.random.default_rng(streams[k])
    drawn = robot_of(rng, f"robot {k + 1}")
    every = plan(counts, robots, np.random.default_rng(order), singles)
    cases = [case_of(kind, name, rng, drawn.robot) for kind, name in every[k]]
    return drawn, cases, rng, sum(map(len, every[:k]))


def make_robot(
    out: Path, seed: int, robots: int, k: int, counts: dict[str, int], singles: Sequence[str],
    device: str, cell_m: float, seconds: float,
) -> str:  # fmt: skip
    """Swim all cases of robot ``k``, write what they show and what is true of them."""
    start = time.perf_counter()
    drawn, cases, rng, first = made(seed, robots, k, counts, singles)
    J = len(drawn.robot.joints)
    swims = [(case, part) for case in cases for part in ("a", "b", "plain")]
    swims += [(Case("null", {}, {}, True, cases[0].camera), f"ref_{n + 1}") for n in range(2)]
    commands = {
        id(case): [command_of(rng, J, CONTROL_S, seconds) for _ in "ab"] for case, _ in swims
    }
    starts = {id(case): [start_of(rng, case) for _ in "ab"] for case, _ in swims}
    which = [int(part in ("b", "ref_2")) for _, part in swims]
    sent = np.stack([commands[id(c)][w] for (c, _), w in zip(swims, which, strict=True)], axis=1)
    begin = np.array([starts[id(c)][w] for (c, _), w in zip(swims, which, strict=True)])
    plain = np.array([part == "plain" for _, part in swims])
    begin[plain, 0] += NUDGE_M
    true: dict[str, Any] = {"areas": drawn.areas, **drawn.servos}
    truths = [Truth(part, {} if part == "plain" else case.effects, **true) for case, part in swims]
    world = World(
        truths, device=device, cell_m=cell_m, rng=rng, robot=drawn.robot, water=drawn.water
    )
    poses, joints, lost = world.swim(begin, sent)
    poses[:, plain, 0] -= NUDGE_M
    t = CONTROL_S * np.arange(len(sent))
    label = f"robot_{k + 1:02d}"
    folder = out / "inputs" / label
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.toml").write_text(robot_toml(drawn))
    joint_names = [one.name for one in drawn.robot.joints]
    model = drawn.model()
    write_model(model, folder / "model.json")
    answers = []
    shown: list[Array] = []
    dice = [seed, k]
    for e, (case, part) in enumerate(swims):
        given = (t, poses[:, e], joints[:, e], truths[e].effects)
        shown.append(seen(*given, np.random.default_rng(dice + [e])))
        if part == "plain":
            continue
        noisy = seen(*given, np.random.default_rng(dice + [e]), case.camera)
        recording = Recording(
            name=part, kind="pool", joints=tuple(joint_names), t=t, command=sent[:, e],
            position=reported(joints[:, e], rng), medium="water", source=SOURCE,
            columns={
                f"body.{n}": column
                for n, column in zip(("x_m", "y_m", "yaw_rad"), noisy.T, strict=True)
            },
        )  # fmt: skip
        number = first + next((i for i, one in enumerate(cases) if one is case), 0) + 1
        place = {"a": out / "inputs" / label / f"case_{number:04d}",
                 "b": out / "heldout" / f"case_{number:04d}"}.get(part, folder)  # fmt: skip
        if not lost[e]:
            write_recording(recording, place / f"{part}.csv")
    for i, case in enumerate(cases):
        at = 3 * i
        name = f"case_{first + i + 1:04d}"
        if lost[at : at + 3].any():
            answers.append({"case": name, "kind": case.kind, "stopped": True})
            continue
        about = {"references": case.referred}
        (folder / name / "case.json").write_text(json.dumps(about) + "\n")
        answers.append({
            "case": name, "robot": label, "kind": case.kind,
            "effects": [
                {"effect": n.partition(".")[0], "component": component(n),
                 "parameters": p, "strength": case.strength.get(n)}
                for n, p in case.effects.items()
            ],
            "references": case.referred, "camera": case.camera,
            "oracle": known_to(
                t, shown[at], joints[:, at], shown[at + 2], joints[:, at + 2], sent[:, at],
                case, drawn, model,
            ),
        })  # fmt: skip
    private = out / "private"
    private.mkdir(exist_ok=True)
    np.savez_compressed(
        private / f"{label}.npz", pose=poses.astype(np.float32), joint=joints.astype(np.float32),
        sent=sent.astype(np.float32), shown=np.array(shown, np.float32), lost=lost,
    )  # fmt: skip
    about = {
        "robot": label, "servos": drawn.servos, "bench": drawn.bench, "areas": drawn.areas,
        "water": vars(drawn.water), "cell_m": cell_m, "cases": answers,
    }  # fmt: skip
    part = private / f"{label}.part"
    part.write_text(json.dumps(about, indent=1) + "\n")
    part.rename(private / f"{label}.json")
    return f"{label}: {len(swims)} boxes, {lost.sum()} stopped, {time.perf_counter() - start:.0f} s"


def component(name: str) -> str:
    """Component of an effect by its identifier: a material, camera, servos or body."""
    effect, _, material = name.partition(".")
    if material:
        return material
    camera = ("camera_latency", "camera_rotation", "camera_scale", "marker_offset", "pose_filter",
              "dropped_frames", "drifting_mount", "bending_marker")  # fmt: skip
    return "servos" if effect == "coulomb_friction" else "camera" if effect in camera else "body"


def robot_toml(drawn: Drawn) -> str:
    """The robot's file."""
    parts = [f'name = "{drawn.robot.name}"\n']
    for link in drawn.robot.links:
        rows = {"mass_kg": link.mass_kg, "length_m": link.length_m, "width_m": link.width_m,
                "height_m": link.height_m}  # fmt: skip
        numbers = "".join(f"{k} = {v:g}\n" for k, v in rows.items())
        parts.append(f'[[links]]\nname = "{link.name}"\n{numbers}material = "{link.material}"\n')
        parts += [appendage_toml(one) for one in link.appendages]
    for joint in drawn.robot.joints:
        low, high = joint.limits_rad
        parts.append(
            f'[[joints]]\nname = "{joint.name}"\nservo = "servo"\nlimits_rad = [{low}, {high}]\n'
        )
    sheet = drawn.robot.joints[0].servo
    parts.append(
        f"[servos.servo]\nmax_torque_Nm = {sheet.max_torque_Nm}\n"
        f"no_load_speed_rad_s = {sheet.no_load_speed_rad_s}\n"
        f"position_step_rad = {sheet.position_step_rad}\n"
    )
    return "\n".join(parts)


def appendage_toml(bar: Appendage) -> str:
    """A cylinder across its link, as a table of the robot's file."""
    if bar.drag is None:
        raise ValueError(f"no drag coefficient of {bar.name}")
    rows = {
        "name": f'"{bar.name}"', "shape": f'"{bar.shape}"', "axis": f'"{bar.axis}"',
        "size_m": [bar.size_m[1], bar.size_m[0]], "at_m": list(bar.at_m),
        "submerged": bar.submerged, "drag_coefficient": [round(x, 6) for x in bar.drag],
    }  # fmt: skip
    table = "".join(f"{name} = {value}\n" for name, value in rows.items())
    return f"[[links.appendages]]\n{table}"


def consulted(
    out: Path, seed: int, robots: int, counts: dict[str, int], singles: Sequence[str]
) -> None:
    """Compute the oracles anew from the swims that were kept without noise."""
    for path in sorted((out / "private").glob("robot_*.json")):
        about, kept = json.loads(path.read_text()), np.load(path.with_suffix(".npz"))
        drawn, cases, _, _ = made(seed, robots, int(path.stem[-2:]) - 1, counts, singles)
        model = read_model(out / "inputs" / path.stem / "model.json")
        shown, joint, sent = (kept[name].astype(np.float64) for name in ("shown", "joint", "sent"))
        t = CONTROL_S * np.arange(len(sent))
        for i, (case, truth) in enumerate(zip(cases, about["cases"], strict=True)):
            if not truth.get("stopped"):
                at = 3 * i
                truth["oracle"] = known_to(
                    t, shown[at], joint[:, at], shown[at + 2], joint[:, at + 2], sent[:, at],
                    case, drawn, model,
                )  # fmt: skip
        path.write_text(json.dumps(about, indent=1) + "\n")


def finish(out: Path, seed: int) -> None:
    """Write the answers of all robots that were made, and what is published of the set."""
    kept = sorted((out / "private").glob("robot_*.json"))
    robots = [json.loads(path.read_text()) for path in kept]
    cases = [one for robot in robots for one in robot["cases"] if not one.get("stopped")]
    content = {"tier": "T4", "seed": seed, "robots": robots, "cases": cases}
    (out / "answers.json").write_text(json.dumps(content, indent=1) + "\n")
    (out / "hashes.json").write_text(json.dumps(hashes(out), indent=1) + "\n")


def hashes(out: Path) -> dict[str, str]:
    """SHA-256 of the answers, of all recordings together, of each file of this folder."""
    whole = hashlib.sha256()
    for path in sorted([*(out / "inputs").rglob("*"), *(out / "heldout").rglob("*")]):
        if path.is_file():
            whole.update(str(path.relative_to(out)).encode() + path.read_bytes())
    own = sorted(Path(__file__).parent.glob("*.py"))
    return {
        "answers.json": hashlib.sha256((out / "answers.json").read_bytes()).hexdigest(),
        "recordings": whole.hexdigest(),
        **{path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in own},
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Make the set."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--device", default="cpu", help="one or several, with commas between")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--seed", type=int, help="default: drawn, and kept in the answers")
    parser.add_argument("--robots", type=int, default=ROBOTS)
    parser.add_argument("--cell-m", type=float, default=LEAST_M)
    parser.add_argument("--seconds", type=float, default=SECONDS, help="of a swim")
    parser.add_argument(
        "--effects",
        nargs="*",
        default=(),
        choices=list(NOMINAL),
        metavar="EFFECT",
        help="of cases with one effect, in turn; default: all",
    )
    parser.add_argument("--seconds-left", type=float, help="then give up")
    parser.add_argument("--finish", action="store_true", help="write answers of what was made")
    for kind, count in COUNTS.items():
        parser.add_argument(f"--{kind}", type=int, default=count, metavar="N")
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    kept = options.out / "private" / "seed.txt"
    kept.parent.mkdir(exist_ok=True)
    if not kept.exists():
        kept.write_text(str(secrets.randbits(63) if options.seed is None else options.seed))
    seed = int(kept.read_text())
    counts = {kind: getattr(options, kind) for kind in COUNTS}
    if options.finish:
        consulted(options.out, seed, options.robots, counts, options.effects)
        finish(options.out, seed)
        return
    devices = options.device.split(",")
    missing = [
        k for k in range(options.robots) if not (kept.parent / f"robot_{k + 1:02d}.json").exists()
    ]
    jobs = [
        (options.out, seed, options.robots, k, counts, options.effects, devices[n % len(devices)],
         options.cell_m, options.seconds)
        for n, k in enumerate(missing)
    ]  # fmt: skip
    failed = 0
    if options.processes <= 1:
        for job in jobs:
            print(make_robot(*job), flush=True)
    else:
        spawn = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(options.processes, mp_context=spawn) as pool:
            futures = [pool.submit(make_robot, *job) for job in jobs]
            for done in as_completed(futures, timeout=options.seconds_left):
                failed += done.exception() is not None
                print(done.exception() or done.result(), flush=True)
    finish(options.out, seed)
    if failed:
        raise SystemExit(f"{failed} robots failed")


if __name__ == "__main__":
    main()
