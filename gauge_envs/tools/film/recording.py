"""A real recording as a panel, on the clock of the simulation."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gauge_envs.errors import VideoError
from gauge_envs.tools.video.frames import FileFrames


class RecordedPanel:
    """Pictures of a video file; each is shown from its time to that of the next one.

    Args:
        file: The video.
        start_s: Time in the video at which the experiment starts [s].
        rate_hz: Pictures that the camera took in a second of the experiment; None for the times in the file.
        width: Width of the pictures [pixels].
        height: Height of the pictures [pixels].
    """

    def __init__(self, file: Path, *, start_s: float, rate_hz: float | None, width: int, height: int) -> None:
        self._frames = FileFrames(file, fps=rate_hz)
        self._size = (width, height)
        count = sum(1 for _ in self._frames.native())
        times_s = self._frames.times_s
        # With a stated rate the times follow from it.
        self._times_s = np.arange(count) / self._frames.fps if times_s is None else times_s
        ends_s = float(self._times_s[-1])
        if not 0.0 <= start_s <= ends_s:
            raise VideoError(f"{file}: its pictures are from 0 s to {ends_s:.3f} s; the start is at {start_s:g} s")
        self.title, self.detail = "real", file.name
        self.note = f"recording from {start_s:.3f} s of the file"
        self.last_s = ends_s - start_s
        self._start_s = start_s
        self._pictures: Iterator[NDArray[np.uint8]] = iter(())
        self._index = -1
        self._shown = np.zeros((height, width, 3), dtype=np.uint8)

    def picture(self, time_s: float) -> NDArray[np.uint8]:
        """Return the picture that is shown at a time [s], shape [height, width, 3]; the last one stays."""
        # Times in files are whole milliseconds or ticks.
        wanted = int(np.searchsorted(self._times_s, self._start_s + time_s + 5e-4, side="right")) - 1
        if self._index < 0:
            self._pictures = self._frames.native()
        latest = None
        while self._index < wanted:
            latest = next(self._pictures)
            self._index += 1
        if latest is not None:
            self._shown = self._fitted(latest)
        return self._shown

    def close(self) -> None:
        """Close the file."""
        self._pictures = iter(())
        self._index = -1

    def _fitted(self, picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return a picture of blue, green and red as one of red, green and blue that fits, on a grey ground."""
        image = Image.fromarray(np.ascontiguousarray(picture[:, :, ::-1]))
        scale = min(self._size[0] / image.width, self._size[1] / image.height)
        fitted = (max(1, round(scale * image.width)), max(1, round(scale * image.height)))
        ground = Image.new("RGB", self._size, (225, 228, 232))
        corner = ((self._size[0] - fitted[0]) // 2, (self._size[1] - fitted[1]) // 2)
        ground.paste(image.resize(fitted, Image.Resampling.LANCZOS), corner)
        return np.asarray(ground)
