"""Command-line options for recordings, identification, ranges, exports and imports."""

from __future__ import annotations

from sim2real import exchange, verbs
from sim2real.commands.command import VIEWS, Command

_RUNS, _EXPORTS = "sim2real.commands.recordings", "sim2real.commands.exports"
_IMPORTS = "sim2real.commands.import_logs"


_IDENTIFY = """
--out MODEL!: model to write (MODEL.json)
--no-plots: do not plot the fits (MODEL.JOINT.png)
"""
_RANGES = """
--out FILE!: ranges to write (ranges.json)
--no-page: do not write the HTML report
"""
_LATENCY = """
--out FILE: ranges to write (latency.json)
--plot PNG: plot of the causes to write
"""
_PREDICT = """
model MODEL: model (MODEL.json)
commands CSV: commands: a CSV with t_s and J.command_rad
--out CSV!: prediction to write (predicted.csv)
"""
_EXPORT_SERVO = """
model MODEL: identified servos (MODEL.json)
--to mujoco|mjlab|isaaclab|isaaclab-bam|newton|usd|genesis|urdf|casadi|json!: simulator or
    format to write for
--out FILE!: file to write
"""
_EXPORT_RANGES = """
ranges FILE: randomization ranges (ranges.json)
--to isaaclab|mjlab|newton|mujoco-playground!: simulator to write for
--out FILE!: Python file to write
"""
_ROBOT = """
action from-urdf: format to read
source FILE: description of the robot (URDF)
--out TOML!: robot to write (robot.toml)
--joints JOINT+: joints to take, in order (default: all)
"""
_SERVOS = """
name NAME?: servo to show or to write; 'add' to prepare an entry
model MODEL?: add: identified servo (MODEL.json)
--out MODEL: model to write (add: entry, NAME.json)
--joints JOINT+: joints that have this servo (default j1)
--firmware-gain X: write the model for this gain of the firmware; add: that of the recordings
--supply X: write the model for this supply voltage, V; add: that of the recordings
--plot PNG: plot of stall torque and no-load speed to write
--joint JOINT: add: joint of a model that has several
--as NAME: add: name of the entry
--type TEXT: add: make and type of the servo
--source TEXT: add: where the recordings come from
--licence TEXT: add: licence of the recordings
--date DAY: add: day of the recordings (2026-01-31)
"""
_DENSITY = """
robot TOML: the robot, with masses and lengths of its links (robot.toml)
--model MODEL: model to add the densities to (MODEL.json)
--out MODEL: model to write (MODEL.json)
--plot PNG: plot of the mass distribution to write
"""
_IMPORT = """
--out CSV!: recording to write (of parameters: model)
--command-topic TOPIC&: bag: commanded positions; once, or once for each joint
"""


COMMANDS = {
    "example": Command(
        f"{_RUNS}:example", ["--out FOLDER = example: folder to write"], "--out example"
    ),
    "check": Command(f"{_RUNS}:check", [verbs.check], "steps.csv sine.csv --robot robot.toml"),
    "identify": Command(
        f"{_RUNS}:identify",
        [verbs.identify, _IDENTIFY, VIEWS],
        "steps.csv sine.csv square.csv --robot robot.toml --out model.json",
    ),
    "density": Command(
        f"{_RUNS}:density",
        [_DENSITY, verbs.density],
        "robot.toml --model model.json --out weighed.json",
    ),
    "predict": Command(
        f"{_RUNS}:predict", [_PREDICT, VIEWS], "model.json chirp.csv --out predicted.csv"
    ),
    "latency": Command(
        f"{_RUNS}:latency", [verbs.latency, _LATENCY], "steps.csv square.csv --out latency.json"
    ),
    "completion": Command(
        f"{_RUNS}:completion",
        ["shell bash|zsh|tcsh: shell to write the script for"],
        "bash > ~/.local/share/bash-completion/completions/sim2real",
    ),
    "import": Command(
        _IMPORTS,
        [_IMPORT, exchange.import_log],
        "run.bag --state-topic /joint_states --command-topic /goal --out run.csv",
    ),
    "robot": Command(f"{_IMPORTS}:robot", [_ROBOT], "from-urdf arm.urdf --out robot.toml"),
    "export-servo": Command(
        f"{_EXPORTS}:export_servo",
        [_EXPORT_SERVO, exchange.export],
        "diagnosis.enriched.json --to mujoco --out servos.xml --recordings steps.csv chirp.csv",
        leave_out=("source",),
    ),
    "export-ranges": Command(
        f"{_EXPORTS}:export_ranges",
        [_EXPORT_RANGES],
        "ranges.json --to isaaclab --out randomization.py",
    ),
    "servos": Command(
        "sim2real.commands.servos", [_SERVOS], "xl330_gain800 --joints pan tilt --out model.json"
    ),
    "ranges": Command(
        f"{_RUNS}:ranges",
        [verbs.ranges, _RANGES],
        "steps.csv square.csv --robot robot.toml --model model.json --out ranges.json",
        resumes=True,
        leave_out=("chains",),
    ),
}
