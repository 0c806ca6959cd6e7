"""A window that shows the pool while a policy swims: ``render_mode="human"``."""

from __future__ import annotations

from typing import Any

import numpy as np

from sim2real.arrays import Picture
from sim2real.errors import InputError, library

_WHERE = "render_mode 'human'"


class Window:
    """A window on the screen, drawn by pygame (SDL), which shows pictures in real time.

    With the environment variable ``SDL_VIDEODRIVER=dummy`` SDL draws into memory only, so that it
    works on a machine without a screen.

    Attributes:
        frames_per_s: Pictures a second at most; ``show`` waits where they come faster.
    """

    def __init__(self, frames_per_s: float, title: str = "sim2real/Fish-v0") -> None:
        """Prepare a window; it opens with the first picture.

        Args:
            frames_per_s: Pictures a second at most.
            title: Text of the title bar.

        Raises:
            InputError: If pygame is not installed, or there is no screen to draw on.
        """
        pygame = library("pygame", "sim2real/Fish-v0")
        self._pygame: Any = pygame
        self.frames_per_s, self._title = frames_per_s, title
        self._surface: Any = None
        try:
            pygame.display.init()
        except pygame.error as error:
            expected = "a screen, or render_mode 'rgb_array'"
            raise InputError("sim2real/Fish-v0", _WHERE, f"no screen ({error})", expected) from None
        self._clock = pygame.time.Clock()

    def show(self, picture: Picture) -> None:
        """Show a picture, shape (height, width, 3), 8 bits a channel, then wait for its time."""
        pygame = self._pygame
        height, width, _ = picture.shape
        if self._surface is None:
            self._surface = pygame.display.set_mode((width, height))
            pygame.display.set_caption(self._title)
        pygame.surfarray.blit_array(self._surface, np.swapaxes(picture, 0, 1))
        pygame.event.pump()  # keeps the window responsive
        pygame.display.flip()
        self._clock.tick(self.frames_per_s)

    def shown(self) -> Picture:
        """The pixels that the window shows now, shape (height, width, 3)."""
        pixels = self._pygame.surfarray.array3d(self._surface)
        return np.ascontiguousarray(np.swapaxes(pixels, 0, 1))

    def close(self) -> None:
        """Close the window."""
        self._surface = None
        self._pygame.display.quit()
