"""Signals and motion for viewers of time series: files for Rerun, and MCAP files for Foxglove.

A ``Scene`` holds what is shown, whatever the viewer; ``scenes`` makes them from recordings,
predictions and diagnoses. The viewers' libraries are imported when a file is written.
"""

from sim2real.viewers.mcap_file import write_mcap
from sim2real.viewers.rerun_file import write_rerun
from sim2real.viewers.signal_group import MovingLine, Scene, SignalGroup

__all__ = ["SignalGroup", "Scene", "MovingLine", "write_mcap", "write_rerun"]
