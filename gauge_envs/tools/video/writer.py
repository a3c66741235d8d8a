"""Write films frame by frame with FFmpeg, whole or not at all."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from gauge_envs.errors import VideoError, needs_extra
from gauge_envs.files import os_errors, replaced_whole

FORMATS = {
    ".mp4": ("libx264", "yuv420p", "-crf 20 -movflags +faststart -f mp4"),
    ".webp": ("libwebp_anim", "yuv420p", "-quality 82 -loop 0 -f webp"),
}
"""Codec, pixels and options of FFmpeg by the suffix of a film."""

SAME = "-threads 1 -fflags +bitexact"
"""Options by which the same frames give the same file: one thread, and no date."""


@contextmanager
def film_writer(
    file: Path, *, size: tuple[int, int], fps: float
) -> Iterator[Callable[[Any], None]]:
    """Yield a receiver of frames, pictures in red, green and blue; the film is in its place once all are there.

    After an error there is no file.

    Args:
        file: The film, `.mp4` or `.webp`. Its folder is created.
        size: Width and height [pixels]; an MP4 needs even numbers.
        fps: Frames a second.
    """
    with needs_extra("a film", "video"):
        import imageio_ffmpeg
    codec, pixels, options = FORMATS[file.suffix.lower()]
    with os_errors(lambda cause: VideoError(f"{file}: cannot be written: {cause}")):
        file.parent.mkdir(parents=True, exist_ok=True)
        with replaced_whole(file) as part:
            stream = imageio_ffmpeg.write_frames(
                str(part),
                size,
                fps=fps,
                codec=codec,
                pix_fmt_out=pixels,
                quality=None,
                macro_block_size=1,
                ffmpeg_log_level="error",
                output_params=f"{options} {SAME}".split(),
            )
            try:
                stream.send(None)
                yield lambda frame: stream.send(np.ascontiguousarray(frame))
            finally:
                stream.close()
            if not part.is_file() or not part.stat().st_size:
                raise VideoError(f"{file}: ffmpeg has written nothing")
