"""Commands that need the fluid or its twin for bodies in the water."""

from sim import verbs
from sim2real.commands.command import VIEWS, Command

_SWIMS = "sim.commands.swims"
_NO_PAGE = "--no-page: do not write the HTML page"
_CALIBRATE = """
--out MODEL!: model to write (MODEL.json)
--no-plots: do not plot the fit (MODEL.RECORDING.png)
"""
_FIT_TWIN = """
robot TOML: the robot (robot.toml)
--out MODEL!: model to write, with the law in its body (MODEL.json)
"""
_SIMULATE = """
model MODEL: servos and body (MODEL.json)
recordings CSV: recording or table of commands (t_s, J.command_rad)
--out CSV!: recording to write
"""


COMMANDS = {
    "design": Command(
        f"{_SWIMS}:design",
        [verbs.design, "--out CSV!: commands to write (next.csv)", _NO_PAGE],
        "--robot robot.toml --model model.json --out next.csv",
    ),
    "diagnose": Command(
        "sim.commands.diagnose",
        [verbs.diagnose, "--out FILE!: diagnosis to write (diagnosis.json)", _NO_PAGE, VIEWS],
        "steps.csv chirp.csv --robot robot.toml --out diagnosis.json",
    ),
    "simulate": Command(
        f"{_SWIMS}:simulate",
        [_SIMULATE, VIEWS, verbs.simulate],
        "model.json wave.csv --robot fish.toml --out swim.csv",
    ),
    "fit-twin": Command(
        f"{_SWIMS}:fit_twin",
        [_FIT_TWIN, verbs.fit_twin],
        "robot.toml --model model.json --out fitted.json",
    ),
    "calibrate": Command(
        f"{_SWIMS}:calibrate",
        [verbs.calibrate, _CALIBRATE],
        "swim.csv --robot fish.toml --model model.json --out calibrated.json",
    ),
}
