"""Write films frame by frame with FFmpeg, whole or not at all."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import ParameterError, VideoError, needs_extra
from gauge_envs.files import MEGABYTE, os_errors, replaced_whole

PALETTE = "split[a][b];[a]palettegen[p];[b][p]paletteuse=dither=none"
"""Filter by which all frames of a GIF share their colours, so that what stands still keeps its own."""

FORMATS = {
    ".mp4": ("libx264", "yuv420p", "-crf 20 -movflags +faststart -f mp4"),
    ".webp": ("libwebp_anim", "yuv420p", "-quality 82 -loop 0 -f webp"),
    ".gif": ("gif", "pal8", f"-vf {PALETTE} -loop 0 -f gif"),
}
"""Codec, pixels and options of FFmpeg by the suffix of a film."""

SAME = "-threads 1 -fflags +bitexact"
"""Options by which the same frames give the same file: one thread, and no date."""

MOST_HELD_BYTES = 600 * MEGABYTE
"""Largest memory of the frames of a GIF, whose colours are chosen at the end; other frames are not held."""


class FilmWriter:
    """Receiver of the frames of a film.

    Args:
        stream: FFmpeg, which takes frames one by one.
        most_bytes: Largest size of all frames.
    """

    def __init__(self, stream: Any, most_bytes: float) -> None:
        self._stream, self._left_bytes = stream, most_bytes

    def add(self, frame: NDArray[np.uint8], *, times: int = 1) -> None:
        """Add a picture of red, green and blue, shape [height, width, 3], for a number of frames."""
        self._left_bytes -= times * frame.nbytes
        if self._left_bytes < 0.0:
            raise ParameterError(
                f"the frames take more than {MOST_HELD_BYTES // MEGABYTE} MB of memory: give a smaller width, height "
                "or fps, a shorter span, or write an .mp4 or .webp, which hold one frame"
            )
        for _ in range(times):
            try:
                self._stream.send(np.ascontiguousarray(frame))
            except OSError as error:
                raise VideoError(f"ffmpeg has stopped: {error}") from error


@contextmanager
def film_writer(
    file: Path, *, size: tuple[int, int], fps: float
) -> Iterator[FilmWriter]:
    """Yield a writer of a film, which is in its place once all frames are there; after an error there is no file.

    Args:
        file: The film; its suffix states the format. Its folder is created.
        size: Width and height [pixels]; an MP4 needs even numbers.
        fps: Frames a second.
    """
    check_film_format(file)
    import imageio_ffmpeg

    suffix = file.suffix.lower()
    codec, pixels, options = FORMATS[suffix]
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
                yield FilmWriter(
                    stream, MOST_HELD_BYTES if suffix == ".gif" else float("inf")
                )
            finally:
                stream.close()
            if not part.is_file() or not part.stat().st_size:
                raise VideoError(f"{file}: ffmpeg has written nothing")


def check_film_format(file: Path) -> None:
    """Check that films of the format of a file can be written here."""
    if file.suffix.lower() not in FORMATS:
        *others, last = FORMATS
        raise ParameterError(
            f"{file}: the suffix states the format: choose {', '.join(others)} or {last}"
        )
    with needs_extra("a film", "video"):
        import imageio_ffmpeg
    try:
        imageio_ffmpeg.get_ffmpeg_exe()
    except RuntimeError as error:
        raise VideoError(f"there is no ffmpeg: {error}") from error
