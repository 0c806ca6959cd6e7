"""Signals and motion for viewers of time series: files for Rerun, and MCAP files for Foxglove.

A ``Scene`` holds what is shown, whatever the viewer; ``scenes`` makes them from recordings,
predictions and diagnoses. The viewers' libraries are imported when a file is written.
"""

from sim2real.viewers.scenes import MovingLine, Scene, SignalGroup, write_mcap, write_rerun

__all__ = ["SignalGroup", "Scene", "MovingLine", "write_mcap", "write_rerun"]
