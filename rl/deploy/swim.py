"""The loop that lets a policy drive a robot to a target, over the air."""

from __future__ import annotations

import time
from collections.abc import Callable

from rl.deploy.link import SILENCE_S, Link, Telemetry
from rl.deploy.measurements import CONTROL_S
from rl.deploy.pilot import Pilot, Track

ANSWER_S = 3.0
"""The robot's first word must come within this time."""
_ASK_S = 0.1
_GOODBYES = 5
"""Times that rest is sent at the end: datagrams get lost."""


def swim(
    link: Link,
    pilot: Pilot,
    *,
    interrupted: Callable[[], bool] = lambda: False,
    progress: Callable[[float], object] = lambda _: None,
) -> Track | None:
    """Drive the robot until the pilot has done; then, and whatever happens, send it to rest.

    The robot's telemetry sets the pace: it is answered at once.

    Args:
        link: To the robot.
        pilot: Who answers.
        interrupted: Whether the user has asked to stop.
        progress: Told the seconds that have passed since it was told last.

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
            before, now = pilot.swum_s, time.monotonic()
            command = pilot.answer(news, now)
            if command is not None:
                answered = now
                link.send(command)
                progress(max(pilot.swum_s, 0.0) - max(before, 0.0))
            elif now - answered > SILENCE_S:
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
    """The robot's first words; none if it does not answer."""
    deadline = time.monotonic() + ANSWER_S
    while time.monotonic() < deadline:
        if interrupted():
            raise KeyboardInterrupt
        link.begin()
        news = link.receive(_ASK_S)
        if news:
            return news
    return []
