"""Cases of ``yardstick.py``: recordings of development seeds, and what is true of them.

Servos come from the generators of ``datasets/foreign`` and ``datasets/concealed``. Swims are the
seven that ship (``datasets/pool``, recorded in the fluid) and thirteen whose robots, commands and
effects are drawn by ``datasets/pool/drawn.py`` and that swim in the twin with a law of their own:
in the fluid they would take a GPU. Real servos (K-Scale Labs, github.com/kscalelabs/sysid) and
inputs that failed are in ``../shared``. Remove ``build/yardstick`` after a change of a generator.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.harness import ROOT

if TYPE_CHECKING:
    from drawn import Drawn, Effects

SHARED = ROOT.parent / "shared"
POOL = ROOT / "datasets" / "pool"
SEED = 63
SERVOS = {
    "foreign/make_foreign": {"null": 8, "single": 7, "double": 3, "outside": 2},
    "concealed/make": {"null": 3, "single": 9, "double": 5, "outside": 3},
}
"""Generator of ``datasets``, and cases of each kind."""
SWIMS = (*["null"] * 3, *["single"] * 6, *["double"] * 2, "drifting_mount", "bending_marker")
"""Kinds of the swims in the twin, or what is outside the catalogue; every other has a reference."""
LAW = {
    "across": 1.04, "along": 0.0024, "added_mass": 1.17, "thrust": 0.79, "linear": 0.1,
    "slender": 36.2, "head": 1.02, "axial": 0.0376, "wake": 0.0444,
    "wake_s": 1.71, "tail": 1.76, "lag": 0.0583,
}  # fmt: skip
"""Mean law of the robots in the twin; that of each differs by 10 %, one standard deviation."""
NAMES = {"kp": "kp_Nm_per_rad", "kd": "kd_Nms_per_rad", "latency": "latency_s"}
MOTOR = {
    "stall_Nm": "motor.stall_torque_Nm",
    "no_load_speed_rad_s": "motor.no_load_speed_rad_s",
    "rotor_inertia": "motor.rotor_inertia_kgm2",
}
"""Parameters of a servo and of its motor in the answers of generators, and in a model."""
REAL = "m535_l100", "m1168_l100"
SMOOTH = "sin_sin", "sin_time_square", "up_and_down"
IMPORTS = {
    "two_publishers/steps_two": (
        "--state-topic", "/joint_states", "--command-topic", "/cmd",
        "--joints", "arm/pan", "arm/tilt",
    ),
    "semicolons/steps_log.csv": (
        "--columns", "t=Zeit [ms]", "j1.command=Soll [°]", "j1.position=Ist [°]",
        "--time-unit", "ms", "--units", "deg",
    ),
}  # fmt: skip
"""Raw files in ``cases``, and the options of ``sim2real import``."""


@dataclass(frozen=True)
class Case:
    """Recordings, and what is asked about them.

    Attributes:
        name: ``GROUP/NAME``.
        verbs: ``identify``, ``diagnose``, ``diagnose with model``, ``calibrate`` or ``import``.
        recordings: Files that the verbs take.
        robot: The robot's file.
        held_out: Files of commands and of what was then measured; no verb takes them.
        options: Further options of ``diagnose`` and ``calibrate`` of swims, or of ``import``.
        truth: ``names`` (component and effect), ``allowed`` (nuisances that may be named),
            ``verdict`` and ``estimates`` by name, as far as they are known.
    """

    name: str
    verbs: tuple[str, ...]
    recordings: tuple[Path, ...]
    robot: Path | None = None
    held_out: tuple[tuple[Path, Path], ...] = ()
    options: tuple[str, ...] = ()
    truth: dict[str, Any] = field(default_factory=dict)


def cases(build: Path) -> list[Case]:
    """All cases; those that are generated are written to ``build``."""
    found = [*servos(build), *shipped_swims(), *twin_swims(build / "swims")]
    for folder, of in (("realdata/kscale", real), ("cases", failed)):
        if (SHARED / folder).is_dir():
            found += of(SHARED / folder)
        else:
            print(f"skipped: no {SHARED / folder}")
    return found


def truth_of(
    kind: str, effects: list[Any], joints: dict[str, dict[str, Any]], allowed: Sequence[Any] = ()
) -> dict[str, Any]:
    """Truth from what a generator says of the effects, the joints and the nuisances of a case."""
    estimates = {f"{j}.{NAMES.get(n, n)}": x for j, of in joints.items() for n, x in of.items()}
    for one in effects:
        at = f"{one['component']}.{one['effect']}"
        estimates |= {f"{at}.{n}": x for n, x in one["parameters"].items()}
    verdicts = {"null": "consistent", "trap": "consistent", "outside": "unexplained"}
    return {
        "verdict": verdicts.get(kind, "explained"),
        "names": [f"{one['component']} {one['effect']}" for one in effects],
        "allowed": [f"{one['component']} {one['effect']}" for one in allowed],
        "estimates": estimates,
    }


def servos(build: Path) -> Iterator[Case]:
    """Servos of the two generators; every fourth is diagnosed from its model, too."""
    for script, kinds in SERVOS.items():
        name = script.partition("/")[0]
        out = build / name
        if not (out / "answers.json").exists():
            shutil.rmtree(out, ignore_errors=True)
            counts = [word for kind, n in kinds.items() for word in (f"--{kind}", str(n))]
            file = ROOT / "datasets" / f"{script}.py"
            call = [sys.executable, file, out, "--seed", str(SEED), "--no-oracle", *counts]
            subprocess.run(call, check=True)
        for k, one in enumerate(json.loads((out / "answers.json").read_text())):
            inputs, c = out / "inputs" / one["case"], out / "heldout" / one["case"] / "c.csv"
            joints = {joint: dict(of) for joint, of in one["joints"].items()}
            for of, servo in zip(joints.values(), one.get("servos", ()), strict=False):
                of |= {ours: servo[theirs] for theirs, ours in MOTOR.items()}
                if one["plant"] == "voltage":  # its loads have the rotor's inertia in them
                    of["motor.rotor_inertia_kgm2"] = 0.0
            yield Case(
                f"{name}/{one['case'].removeprefix('case_')}",
                ("identify", "diagnose", *(["diagnose with model"] if k % 4 == 1 else [])),
                (inputs / "a.csv", inputs / "b.csv"),
                inputs / "robot.toml",
                ((c, c),),
                truth=truth_of(one["kind"], one["effects"], joints, one.get("nuisances", ())),
            )


def shipped_swims() -> Iterator[Case]:
    """The swims of ``datasets/pool``; two are calibrated, too."""
    options = ("--model", str(POOL / "model.json"))
    for world in json.loads((POOL / "truth.json").read_text())["worlds"]:
        name = world["name"]
        verbs = ("diagnose", "calibrate") if name in ("clean", "p1") else ("diagnose",)
        truth = swim_truth(world["effects"], {n: world[n] for n in ("kp", "kd", "latency")})
        file = POOL / f"{name}.csv"
        yield Case(f"swim/{name}", verbs, (file,), POOL / "robot.toml", (), options, truth)


def swim_truth(effects: Effects, servos: dict[str, Sequence[float]]) -> dict[str, Any]:
    """Truth from concealed effects, and kp, kd and latency of J servos."""
    sys.path.insert(0, str(POOL))
    from sealed import component

    rows = zip(*servos.values(), strict=True)
    joints = {f"j{j + 1}": dict(zip(servos, row, strict=True)) for j, row in enumerate(rows)}
    named = [
        {"effect": e.partition(".")[0], "component": component(e), "parameters": values}
        for e, values in effects.items()
    ]
    kind = "outside" if effects.keys() & set(SWIMS) else "single" if effects else "null"
    return truth_of(kind, named, joints)


def twin_swims(out: Path) -> Iterator[Case]:
    """Swims of drawn robots in the twin, filmed by the camera of the pool."""
    sys.path.insert(0, str(POOL))
    from drawn import NOMINAL, SECONDS, case_of, command_of, robot_of, start_of
    from sealed import robot_toml

    from sim.robot.swimmer import CONTROL_S
    from sim2real.model import write_model

    for k, kind in enumerate(SWIMS):
        rng = np.random.default_rng([SEED, k])
        folder, drawn = out / f"{k:02d}", robot_of(rng, f"robot {k}")
        if kind in ("null", "single", "double"):
            one = str(rng.choice([n for n in NOMINAL if not n.startswith("surface")]))
            concealed = case_of(kind, one, rng, drawn.robot)
        else:
            concealed = case_of("outside", kind, rng, drawn.robot)
        law = {n: x * float(np.exp(0.1 * rng.standard_normal())) for n, x in LAW.items()}
        swims = {"a": concealed.effects, "ref": {}}
        if not (folder / "model.json").exists():
            folder.mkdir(parents=True, exist_ok=True)
            (folder / "robot.toml").write_text(robot_toml(drawn))
            for swim, effects in swims.items():
                sent = command_of(rng, len(drawn.robot.joints), CONTROL_S, SECONDS)
                start = start_of(rng, concealed)
                write_swim(folder / f"{swim}.csv", drawn, law, effects, sent, start, rng)
            write_model(drawn.model(), folder / "model.json")
        options: tuple[str, ...] = ("--model", str(folder / "model.json"))
        options += ("--references", str(folder / "ref.csv")) if k % 2 else ()
        truth = swim_truth(concealed.effects, drawn.servos)
        files, robot = (folder / "a.csv",), folder / "robot.toml"
        yield Case(f"swim/{k:02d}", ("diagnose",), files, robot, (), options, truth)


def write_swim(
    path: Path, drawn: Drawn, law: dict[str, float], effects: Effects,
    sent: np.ndarray, start: np.ndarray, rng: np.random.Generator,
) -> None:  # fmt: skip
    """Swim commands (T, J) in the twin from a pose, film, write."""
    from camera import reported, seen
    from sealed import component

    from sim.inference.swims import with_values
    from sim.robot.swimmer import CONTROL_S
    from sim.twin.twin import Twin
    from sim2real.model import JointModel, Model
    from sim2real.recording import Recording, write_recording

    area = {"appendage_area": {"ratio": drawn.areas - 1}}
    listed = [
        {"effect": n.partition(".")[0], "component": n.partition(".")[2], "parameters": values}
        for n, values in (effects | area).items()
        if component(n) not in ("camera", "servos")
    ]
    names = tuple(joint.name for joint in drawn.robot.joints)
    true = zip(*(drawn.servos[n] for n in ("kp", "kd", "latency")), strict=True)
    joints = {name: JointModel(*one, 0.002) for name, one in zip(names, true, strict=True)}
    model = Model(joints=joints, body={"twin": law, "effects": listed})
    friction = effects.get("coulomb_friction", {}).items()
    model = with_values(model, {n.replace(".", ".coulomb_friction."): x for n, x in friction})
    twin = Twin(drawn.robot, model)
    twin.reset(pose=start[None])
    track = np.concatenate([[[*start, *np.zeros(len(names))]], twin.swim(sent[:-1])[0]])
    t, noise = CONTROL_S * np.arange(len(sent)), {"position_m": 0.002, "heading_rad": 0.009}
    pose = seen(t, track[:, :3], track[:, 3:], effects, rng, noise)
    columns = dict(zip(("body.x_m", "body.y_m", "body.yaw_rad"), pose.T, strict=True))
    recording = Recording(
        name=path.stem, kind="pool", joints=names, t=t, command=sent,
        position=reported(track[:, 3:], rng), medium="water", columns=columns,
        source="Simulated, not measured: benchmarks/yardstick_cases.py.",
    )  # fmt: skip
    write_recording(recording, path)


def real(folder: Path) -> Iterator[Case]:
    """Two loads at three gains of two servos: first repetitions; the second ones are held out."""
    for servo, load, gain in product(("sts3215", "sts3250"), REAL, (8, 16, 32)):
        stems = [folder / servo / f"{load}_k{gain}_{name}" for name in SMOOTH]
        first, second = (tuple(Path(f"{stem}_r{r}.csv") for stem in stems) for r in (1, 2))
        verbs = ("identify", "diagnose") if gain == 16 else ("identify",)
        name, robot = f"kscale/{servo}_{load}_k{gain}", folder / servo / "robot.toml"
        yield Case(name, verbs, first, robot, tuple(zip(second, second, strict=True)))


def failed(folder: Path) -> Iterator[Case]:
    """Inputs that failed once: recordings in folders with a robot, and raw files to import."""
    for robot in sorted(folder.rglob("robot.toml")):
        files = [p for p in sorted(robot.parent.glob("*.csv")) if p.with_suffix(".json").exists()]
        files = [p for p in files if p.stem != "mixed_commands"]
        held = robot.with_name("mixed_commands.csv"), robot.with_name("mixed_truth.csv")
        known, truth = robot.with_name("truth.json"), {}
        if known.exists():
            content = json.loads(known.read_text())
            effects = [{**one, "parameters": {}} for one in content["truth"]]
            rows = [{n: one[n] for n in NAMES} for one in content["joints"]]
            truth = truth_of("single", effects, {f"j{j + 1}": of for j, of in enumerate(rows)})
        if files:
            name = f"cases/{robot.parent.relative_to(folder).as_posix()}"
            held_out = (held,) if held[1].exists() else ()
            yield Case(name, ("identify", "diagnose"), tuple(files), robot, held_out, truth=truth)
    for path, options in IMPORTS.items():
        yield Case(f"cases/{Path(path).parts[0]}", ("import",), (folder / path,), options=options)
