"""The loop in which a policy drives a robot to a target, over the network."""

from __future__ import annotations

import time
from collections.abc import Callable

from rl.deploy.link import SILENCE_S, Link, Telemetry
from rl.deploy.measurements import CONTROL_S
from rl.deploy.pilot import Pilot, Track

ANSWER_S = 3.0
"""Time within which the robot must answer first."""
_ASK_S = 0.1
_GOODBYES = 5
"""Number of rest messages at the end, as datagrams may be lost."""


def swim(
    link: Link,
    pilot: Pilot,
    *,
    interrupted: Callable[[], bool] = lambda: False,
    progress: Callable[[float], object] = lambda _: None,
) -> Track | None:
    """Drive the robot until the pilot has finished; finally, and after any error, send it to rest.

    The timing is that of the robot's telemetry, which is answered immediately.

    Args:
        link: Link to the robot.
        pilot: Computes the answers.
        interrupted: Whether the user has asked to stop.
        progress: Called with the seconds since its last call.

    Returns:
        The swim, or None if the robot never answered.

    Raises:
        KeyboardInterrupt: If the user asks to stop before the robot has answered.
    """
    news = _contact(link, interrupted)
    if not news:
        return None
    answered = time.monotonic()
    try:
        while not pilot.over:
            before, time_s = pilot.elapsed_s, time.monotonic()
            command = pilot.answer(news, time_s)
            if command is not None:
                answered = time_s
                link.send(command)
                progress(max(pilot.elapsed_s, 0.0) - max(before, 0.0))
            elif time_s - answered > SILENCE_S:
                pilot.stopped = f"no answer from the robot for {SILENCE_S:g} s"
            if interrupted():
                pilot.stopped = "interrupted"
            if not pilot.over:
                news = link.receive(SILENCE_S / 10)
    finally:
        for _ in range(_GOODBYES):
            link.send(pilot.rest)
            time.sleep(CONTROL_S)
    return pilot.track()


def _contact(link: Link, interrupted: Callable[[], bool]) -> list[Telemetry]:
    """First telemetry of the robot; empty if it does not answer."""
    deadline = time.monotonic() + ANSWER_S
    while time.monotonic() < deadline:
        if interrupted():
            raise KeyboardInterrupt
        link.begin()
        news = link.receive(_ASK_S)
        if news:
            return news
    return []
