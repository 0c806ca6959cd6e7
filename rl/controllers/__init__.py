"""Classical and learned controllers with the observations and set-points of the task."""

from typing import Protocol

from sim2real.arrays import Array32


class Controller(Protocol):
    """Controls E robots at 50 Hz."""

    def reset(self) -> None:
        """All robots begin anew."""

    def act(self, observation: Array32) -> Array32:
        """Desired joint angles in rad, shape (E, J), inside the joints' limits.

        ``observation``: surge, sway, yaw rate, J angles, J rates, target x and y in the body's
        frame, SI, (E, 5 + 2 J).
        """
