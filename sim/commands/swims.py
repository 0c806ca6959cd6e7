"""``sim2real simulate``, ``calibrate``, ``fit-twin`` and ``design``."""

import argparse
from dataclasses import replace

from sim import verbs
from sim.robot.swimmer import CONTROL_S
from sim.simulation import SupersonicFlow
from sim2real.commands.command import arguments_of
from sim2real.commands.files import check_written, write_views
from sim2real.design.rivals import RivalDesign
from sim2real.errors import InputError, if_installed
from sim2real.model import write_model
from sim2real.output import beside, check_writable, write_json
from sim2real.recording import write_recording
from sim2real.report.drawing import save_png
from sim2real.robot import read_robot
from sim2real.verbs import robot_of
from sim2real.viewers.scenes import recorded


def simulate(options: argparse.Namespace) -> int:
    """Simulate, and write the measurements of a camera and the servos as a recording."""
    check_written(options)
    try:
        (swim,) = verbs.simulate(**arguments_of(verbs.simulate, options)).swims
    except SupersonicFlow as error:
        states = beside(options.out, f"{options.out.stem}.stopped.json")
        content = {"time_s": error.time_s, "step": error.step, "cell": error.cell}
        poses = [state.pose[0].tolist() for state in error.states]
        joints = [state.joint[0].tolist() for state in error.states]
        write_json(states, {**content, "pose": poses, "joint": joints})
        print(f"sim2real simulate: {error}; last states in {states}")
        return 1
    if options.plot:
        print(f"{options.plot}: the flow at the end")
    source = f"Simulated, not measured: {options.model.name} on {options.recordings.name}."
    write_recording(replace(swim, source=source), options.out)
    write_views(options, lambda: recorded(swim, read_robot(options.robot), "simulated"))
    print(
        f"{options.out}: {swim.t.size} rows at {1 / CONTROL_S:.0f} Hz, {options.cell_m:g} m cells, "
        f"{options.dimensions} dimensions"
    )
    return 0


def calibrate(options: argparse.Namespace) -> int:
    """Calibrate, print the parameters and errors, write the model and a plot of each swim."""
    out = check_writable(options.out)
    calibration = verbs.calibrate(**arguments_of(verbs.calibrate, options))
    write_model(calibration.model, out)
    print(calibration)
    print(f"\nmodel: {out}")
    if not options.no_plots:
        with if_installed("plots"):
            for k, swim in enumerate(calibration.swims):
                plot = beside(out, f"{out.stem}.{swim.name}.png")
                print(f"plot: {save_png(calibration.plot(k), plot)}")
    return 0


def fit_twin(options: argparse.Namespace) -> int:
    """Fit the twin's law, print its errors, write the model."""
    out = check_writable(options.out)
    fitted = verbs.fit_twin(**arguments_of(verbs.fit_twin, options))
    write_model(fitted, out)
    for name in ("surge", "sway", "yaw_rate"):
        held, fish = (100 * (fitted.fit[f"twin.{name}"][k] or 0) for k in ("heldout", "fish"))
        print(
            f"{name}: error in swims held out {held:.1f} %, of the shipped fish's law {fish:.1f} %"
        )
    print(f"model: {out}")
    return 0


def design(options: argparse.Namespace) -> int:
    """Design the next recording; write its commands, what they promise, and a page."""
    if options.out.suffix != ".csv":
        raise InputError("--out", "", str(options.out), "a file name ending in .csv")
    out = check_writable(options.out)
    found = verbs.design(**arguments_of(verbs.design, options))
    print(found)
    if isinstance(found, RivalDesign) and not found.informative:
        return 0
    recording = found.recording(out.stem)
    write_recording(recording, out, measured=False)
    options.result = {k: v for k, v in recording.metadata.items() if k in ("design", "rivals")}
    print(f"{out}: {found.t.size} set-points in {found.t[-1]:.1f} s; play it by")
    print(f"  sim2real record {out} --robot {options.robot} --port PORT --ids IDS --out RECORDING")
    if options.no_page:
        return 0
    with if_installed("page"):
        from sim2real.report.design_plot import design_section, rivals_section
        from sim2real.report.page import write_page

        page = beside(out, f"{out.stem}.html")
        section = rivals_section(found) if isinstance(found, RivalDesign) else design_section(found)
        title = f"The next recording of {robot_of(options.robot).name}"
        write_page(page, title, "The most informative commands", [section], found.provenance)
        print(f"page: {page}")
    return 0
