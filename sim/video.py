"""A video that is written while it is made: each frame goes to the file, none is kept."""

from __future__ import annotations

import contextlib
import os
import tempfile
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from sim.legend import Image
from sim.render import need
from sim2real.output import check_writable

FRAMES_PER_S = 25
QUALITY = 23
"""x264's constant rate factor: less is better and larger."""


class Video:
    """An MP4 file (H.264), open inside a ``with`` block; it appears whole when the block ends.

    An error inside the block leaves nothing behind.
    """

    def __init__(self, path: str | os.PathLike[str], *, frames_per_s: int = FRAMES_PER_S) -> None:
        """Open the file.

        Args:
            path: Where the video will be.
            frames_per_s: How fast it plays.

        Raises:
            InputError: If PyAV is not installed, or ``path`` can't be written.
        """
        need("av", "PyAV")
        import av

        self.path, self.frames = check_writable(path), 0
        self.path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(
            dir=self.path.parent, prefix=f".{self.path.name}.", suffix=".mp4"
        )
        os.close(handle)
        self._temporary = Path(name)
        self._file = av.open(name, "w", format="mp4", options={"movflags": "faststart"})
        self._stream: Any = self._file.add_stream(
            "libx264", rate=frames_per_s, options={"crf": str(QUALITY), "preset": "medium"}
        )
        self._stream.pix_fmt = "yuv420p"

    def add(self, image: Image) -> None:
        """Append a frame; all have the first one's size, both sides even."""
        import av

        if not self.frames:
            self._stream.height, self._stream.width = image.shape[:2]
        self._file.mux(self._stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        self.frames += 1

    def __enter__(self) -> Self:
        """Return the video."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the file, and give it its name if all went well."""
        try:
            if kind is None and self.frames:
                self._file.mux(self._stream.encode(None))
                self._file.close()
                os.chmod(self._temporary, 0o644)
                os.replace(self._temporary, self.path)
        finally:
            with contextlib.suppress(Exception):
                self._file.close()
            with contextlib.suppress(FileNotFoundError):
                self._temporary.unlink()
