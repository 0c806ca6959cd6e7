"""Video that is written frame by frame, without keeping frames in memory."""

import contextlib
import os
import tempfile
from pathlib import Path
from typing import Any, Self

import numpy as np

from sim2real.arrays import Picture
from sim2real.errors import InputError, library
from sim2real.output import check_writable, is_stream, write_whole

FRAMES_PER_S = 25


_FORMATS: dict[str, tuple[str, str, dict[str, str], int]] = {
    ".mp4": ("libx264", "yuv420p", {"crf": "23", "preset": "medium"}, 1280),
    ".avi": ("mpeg4", "yuv420p", {"qmin": "2", "qmax": "4"}, 1280),
    ".gif": ("gif", "pal8", {}, 640),
}
"""Codec, pixels, options and width in pixels by suffix."""


def check_video(path: str | os.PathLike[str]) -> Path:
    """Check before the simulation that a video can be made and written to ``path``."""
    if Path(path).suffix.lower() not in _FORMATS:
        raise InputError(
            path, "", repr(Path(path).suffix), f"a name that ends in {' or '.join(_FORMATS)}"
        )
    library("av", "pictures")
    library("PIL", "pictures")
    return check_writable(path)


class Video:
    """An MP4 (H.264), AVI (MPEG-4) or GIF; made when the ``with`` block ends without an error."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Open the file, whose suffix sets the format."""
        self.path, self.frames = check_video(path), 0
        import av

        ending = self.path.suffix.lower()
        codec, pixels, options, self.width = _FORMATS[ending]
        self.path.parent.mkdir(parents=True, exist_ok=True)
        folder = None if is_stream(self.path) else self.path.parent
        handle, name = tempfile.mkstemp(dir=folder, prefix=f".{self.path.name}.", suffix=ending)
        os.close(handle)
        self._temporary = Path(name)
        faststart = {"movflags": "faststart"} if ending == ".mp4" else {}
        self._file = av.open(name, "w", options=faststart)
        add: Any = self._file.add_stream
        self._stream = add(codec, rate=FRAMES_PER_S, options=options)
        self._stream.pix_fmt = pixels

    def add(self, image: Picture) -> None:
        """Append a frame; all have the size of the first, with even sides."""
        from av import VideoFrame

        if not self.frames:
            self._stream.height, self._stream.width = image.shape[:2]
        frame = VideoFrame.from_ndarray(image, format="rgb24")
        if self._stream.pix_fmt == "pal8":
            frame = VideoFrame.from_ndarray(_in_few_colours(image), format="pal8")
        self._file.mux(self._stream.encode(frame))
        self.frames += 1

    def __enter__(self) -> Self:
        """Return the video."""
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        """Close the file, and write it to ``path`` if there was no error."""
        try:
            if kind is None and self.frames:
                self._file.mux(self._stream.encode(None))
                self._file.close()
                write_whole(self.path, self._temporary.read_bytes())
        finally:
            with contextlib.suppress(Exception):
                self._file.close()
            with contextlib.suppress(FileNotFoundError):
                self._temporary.unlink()


def _in_few_colours(image: Picture) -> Any:  # noqa: ANN401
    """Indices and palette: a GIF has 256 colours, which each frame chooses for itself."""
    from PIL import Image as Pillow

    few = Pillow.fromarray(image).quantize(256, Pillow.Quantize.FASTOCTREE)
    palette = np.zeros((256, 4), dtype=np.uint8)
    chosen = np.array(few.getpalette("RGB"), dtype=np.uint8).reshape(-1, 3)
    palette[:, 0] = 255  # opaque
    palette[: len(chosen), 1:] = chosen
    return np.asarray(few), palette
