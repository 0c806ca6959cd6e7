"""Make the entries of the library of servos anew, and measure them on real recordings.

    python3.12 -m venv /tmp/bam && /tmp/bam/bin/pip install better-actuator-models==1.0.2
    python -m benchmarks.servo_library [--bam /tmp/bam/bin/python] [--processes 2]

Takes the recordings from SIM2REAL_REALDATA (default ../shared/realdata); writes
``sim2real/servo_library/entries/*.json`` and ``reports/servo_library.md``. The error of an entry is
measured by leaving out each trajectory in turn; the model that ships is fitted to all of them. The
published parameters are left as they are without ``--bam``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.bam_agreement import ask, imported
from benchmarks.harness import ROOT, command_line, real_recordings, spread, table
from benchmarks.real_servos import GAINS, TRAJECTORIES, read, residuals
from sim2real.arrays import Array
from sim2real.identification.identify import identify
from sim2real.model import Model, write_model
from sim2real.ranges.population import population
from sim2real.readings import wrong_readings
from sim2real.recording import Recording, read_recording
from sim2real.report.servo_table import COLUMNS, cells
from sim2real.robot import Robot, read_robot
from sim2real.servo.trace import firmware_gain
from sim2real.servo_library.catalogue import FOLDER, JOINT, ServoEntry, at, prepared, shipped

PAGE = ROOT / "reports" / "servo_library.md"
BENCH_V = 7.4
MODELS = ("m1", "m5")
BAM = "Rhoban, BAM: Better Actuator Models (github.com/Rhoban/bam)"
PAPER = "Duclusaud, Passault, Padois, Ly, ICRA 2025"
PUBLISHED = {
    "mx64": ("mx64", "Dynamixel MX-64", 0.15),
    "mx106": ("mx106", "Dynamixel MX-106", 0.15),
    "xl320": ("xl320", "Dynamixel XL-320", 0.1),
    "xl330": ("xl330", "Dynamixel XL330-M288-T", 0.1),
    "feetech_sts3215_7_4V": ("sts3215", "Feetech STS3215 (7.4 V)", 0.1),
}
"""Name in the library, type, and length in m of the pendulum that the entry states."""
KSCALE = {"sts3215": ("6b78737", "2025-03"), "sts3250": ("d66b22c", "2025-03")}
"""Commit and month of the recordings of each servo."""
LOADS = ("m741_l100", "m969_l150", "m1168_l100")
TEXT = """# The library of servos

Made by `python -m benchmarks.servo_library`. `sim2real servos` lists the entries.

{table}

*held out*: root mean square error on trajectories that no fit used, while the torque is on. BAM's
entries are its published parameters (Apache-2.0), mapped to the law of the motor by
`sim2real.importers.bam`; the notes of each entry say what was not mapped. BAM's files
state no load: servos other than the XL330 have a pendulum of a third of the stall torque.

## Other settings of the same servo

`sim2real servos NAME --firmware-gain G --supply V` scales an entry. The XL330 was recorded at two
gains; these are the errors of each entry at both (mrad, RMS; at {supply} V):

{gains}
"""


def main() -> None:
    """Make the entries, and write the page."""
    bam = (str, "Python of the environment that has BAM")
    chosen = command_line(__doc__, bam=bam, processes=2).parse_args()
    real_recordings()
    identified = [
        *spread(xl330, GAINS, chosen.processes, unit="gain"),
        *spread(sts3215, ["single"], chosen.processes, unit="stand"),
        *spread(kscale, KSCALE, chosen.processes, unit="servo"),
    ]
    entries = identified + (published(chosen.bam) if chosen.bam else [])
    for entry in entries:
        write_model(entry.model, FOLDER / f"{entry.name}.json")
    library = shipped()
    names = [f"xl330_gain{gain}" for gain in GAINS]
    names += [name for name in library.names if name.startswith("xl330_bam")]
    rows = [gain_row(library[name]) for name in names]
    gains = table(("entry", *(f"recordings at gain {gain}" for gain in GAINS)), rows)
    servos = [(*cells(entry), entry.licence, entry.source) for entry in library.entries]
    listing = table((*COLUMNS, "licence", "source"), servos)
    text = TEXT.format(table=listing, gains=gains, supply=BENCH_V)
    PAGE.write_text(text)
    print(text)


def bench(gain: int) -> tuple[list[Recording], Robot]:
    """The XL330's recordings at one gain, and its robot."""
    robot = read_robot(real_recordings() / "bam_xl330" / "robot.toml")
    return read(gain, TRAJECTORIES), robot


def xl330(gain: int) -> ServoEntry:
    """The XL330 at one gain, fitted to all trajectories, scored on each from the others."""
    recordings, robot = bench(gain)
    errors = [
        residuals(identify(recordings, robot, held_out=one.name, refit=False), one)
        for one in recordings
    ]
    model = on_all(recordings, robot)
    about = {
        "name": f"xl330_gain{gain}",
        "type": "Dynamixel XL330-M288-T",
        "source": f"recordings of {BAM}, branch xl330, commit af22604, Apache-2.0; identified here",
        "licence": "Apache-2.0",
        "date": "2026-01-15",
        "supply_V": BENCH_V,
        "firmware_gain": gain,
        "scored_on": "each of four trajectories in turn, predicted from the other three",
    }
    return prepared(scored(model, rms(errors)), about)


def sts3215(name: str) -> ServoEntry:
    """The tested servo of a backlash stand; the last quarter of its recording is held out."""
    folder = real_recordings() / "sts3215_backlash"
    robot = read_robot(folder / f"robot_{name}.toml")
    whole = read_recording(folder / f"{name}.csv")
    tested = replace(
        whole,
        joints=("j1",),
        command=whole.command[:, :1],
        position=whole.position[:, :1],
        columns={k: column for k, column in whole.columns.items() if k.startswith("j1.")},
    )
    about = {
        "name": "sts3215_stand",
        "type": "Feetech STS3215",
        "source": "recording of B. Kotov, Robonine (doi 10.5281/zenodo.17903002), stand with one "
        "servo pulled by elastic bands, 10 samples/s, default settings; identified here",
        "licence": "CC BY 4.0",
        "date": "2025-12",
        "scored_on": "the last quarter of the recording, which was not fitted",
    }
    model = identify([tested], robot)
    unknown = {"servo": {"supply_V": None, "firmware_gain": None}}
    return prepared(replace(model, provenance={**model.provenance, **unknown}), about)


def kscale(servo: str) -> ServoEntry:
    """A Feetech on K-Scale's pendulum: one motor at two gains under three loads.

    Single wrong readings are left out. Scored on further runs of the same motions. The spread of
    kp is that of one fit for each gain and load. Its recordings have no licence: they are not
    shipped.
    """
    folder = real_recordings() / "kscale" / servo
    robot = read_robot(folder / "robot.toml")

    def runs(condition: str, repetition: int) -> list[Recording]:
        names = (f"{condition}_{name}_r{repetition}.csv" for name in TRAJECTORIES)
        recordings = [read_recording(folder / name) for name in names]
        wrong = [wrong_readings(r.position[:, 0])[:, None] for r in recordings]
        return [
            replace(r, position=np.where(mask, np.nan, r.position))
            for r, mask in zip(recordings, wrong, strict=True)
        ]

    conditions = [f"{load}_k{gain}" for gain in (8, 16) for load in LOADS]
    model = on_all([one for condition in conditions for one in runs(condition, 1)], robot)
    unseen = [one for condition in conditions for one in runs(condition, 2)]
    common = model.firmware_p_gain or 1.0
    errors = [residuals(model, one, (firmware_gain(one) or common) / common) for one in unseen]
    each = [(servo, identify(runs(condition, 1), robot)) for condition in conditions]
    _, parameters = population(each)
    kp = next(one.components for one in parameters if one.name == f"{JOINT}.kp_Nm_per_rad")
    assert kp.within is not None
    low, middle, high = (100 * x for x in kp.within)
    note = (
        f"kp in proportion to the gain varies by {middle:.2g} % ({low:.2g} to {high:.2g} %) "
        f"between {len(each)} fits at gains 8 and 16 under pendulums of 0.74 to 1.17 kg; one servo"
    )
    joint = model.joints[JOINT]
    model = replace(model, joints={JOINT: replace(joint, notes=(*joint.notes, note))})
    about = {
        "name": f"{servo}_kscale",
        "type": f"Feetech {servo.upper()}",
        "source": f"recordings of K-Scale Labs (github.com/kscalelabs/sysid, commit "
        f"{KSCALE[servo][0]}), which have no licence and are not shipped; identified here",
        "licence": "MIT for these figures, none for the recordings",
        "date": KSCALE[servo][1],
        "supply_V": 12.0,
        "firmware_gain": model.firmware_p_gain,
        "scored_on": "24 further runs of the same motions, gains and loads",
    }
    return prepared(scored(model, rms(errors)), about)


def on_all(recordings: Sequence[Recording], robot: Robot) -> Model:
    """The model fitted to all recordings.

    ``identify`` always holds a recording out; a copy of the last one takes that place here, and the
    error on it is replaced by that of the folds.
    """
    copy = replace(recordings[-1], name="copy", path=None)
    return identify([*recordings, copy], robot, held_out="copy")


def scored(model: Model, error: float) -> Model:
    """The model with another error on held-out data."""
    figures = {**model.fit.get("j1.position_rad", {}), "heldout": error}
    return replace(model, fit={"j1.position_rad": figures})


def rms(errors: Sequence[Array]) -> float:
    """Root mean square of all residuals."""
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


def published(python: str) -> list[ServoEntry]:
    """BAM's parameters, of the friction models in ``MODELS``."""
    answer = ask(python, {})
    entries = []
    for servo in PUBLISHED:
        for friction in MODELS:
            parameters = answer["parameters"].get(f"{servo}/{friction}")
            if parameters is not None:
                entries.append(of_bam(servo, friction, parameters, answer["version"]))
    return entries


def of_bam(servo: str, friction: str, parameters: dict[str, Any], version: str) -> ServoEntry:
    """The entry of one parameter file; the XL330 is scored on its recordings."""
    short, kind, length = PUBLISHED[servo]
    mass = 0.49
    if short != "xl330":
        load = imported(parameters, length).joints["j1"].load
        assert load is not None
        mass = float(f"{load.pendulum_mass_kg:.2g}")
    model = imported(parameters, length, mass)
    about = {
        "name": f"{short}_bam_{friction}",
        "type": kind,
        "origin": "published",
        "source": f"parameters {servo}/{friction} of {BAM}, release {version}; {PAPER}",
        "licence": "Apache-2.0",
        "date": "2026-07-16",
    }
    entry = prepared(model, about)
    if short != "xl330":
        return entry
    errors = [error for gain in GAINS for error in at_gain(entry, gain)]
    on = "eight recordings of one servo at two gains, which its authors did not fit"
    return prepared(scored(model, rms(errors)), about | {"scored_on": on})


def at_gain(entry: ServoEntry, gain: int) -> list[Array]:
    """Residuals in rad of an XL330 on the recordings at one gain."""
    model = at(entry, firmware_gain=gain, supply_V=BENCH_V).model
    return [residuals(model, one) for one in bench(gain)[0]]


def gain_row(entry: ServoEntry) -> tuple[str, ...]:
    """Errors at each gain; in brackets where the recordings are those of the fit."""
    cells = []
    for gain in GAINS:
        error = f"{1e3 * rms(at_gain(entry, gain)):.1f}"
        fitted = entry.origin == "identified" and entry.firmware_gain == gain
        cells.append(f"({error}, fitted)" if fitted else error)
    return (entry.name, *cells)


if __name__ == "__main__":
    main()
