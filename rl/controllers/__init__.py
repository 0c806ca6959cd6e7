"""Controllers to compare a policy with; all see what the policy sees and send what it sends."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class Controller(Protocol):
    """Steers E robots at 50 Hz."""

    def reset(self, mask: NDArray[np.bool_]) -> None:
        """Robots in ``mask``, shape (E,), begin anew; the others go on."""

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Desired joint angles in rad, shape (E, J), inside the joints' limits.

        Args:
            observation: Surge, sway, yaw rate, J angles, J rates, target x and y in the body's
                frame, all SI, shape (E, 5 + 2 J).
        """
