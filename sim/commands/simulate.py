"""``sim2real simulate``."""

from __future__ import annotations

import argparse
from dataclasses import replace

from sim import verbs
from sim.robot.swimmer import CONTROL_S
from sim.simulation import SupersonicFlow
from sim2real.commands.verb import arguments_of
from sim2real.commands.views import check_views, write_views
from sim2real.output import beside, check_writable, write_json
from sim2real.recording import write_recording
from sim2real.robot import read_robot
from sim2real.viewers.scenes import recorded


def run(options: argparse.Namespace) -> int:
    """Simulate, and write the measurements of a camera and the servos as a recording."""
    check_writable(options.out)
    check_views(options)
    try:
        (swim,) = verbs.simulate(**arguments_of(verbs.simulate, options)).swims
    except SupersonicFlow as error:
        states = beside(options.out, f"{options.out.stem}.stopped.json")
        _write_states(error, states)
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


def _write_states(error: SupersonicFlow, path: object) -> None:
    write_json(
        str(path),
        {
            "time_s": error.time_s,
            "step": error.step,
            "cell": error.cell,
            "pose": [state.pose[0].tolist() for state in error.states],
            "joint": [state.joint[0].tolist() for state in error.states],
        },
    )
