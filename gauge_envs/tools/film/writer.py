"""Write films frame by frame, whole or not at all."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gauge_envs.errors import (
    ParameterError,
    ResultFileError,
    VideoError,
    needs_extra,
)
from gauge_envs.files import MEGABYTE, replaced_whole

FILM_SUFFIXES = (".mp4", ".webp", ".gif")
"""Formats of films: MP4 needs the extra `video`."""

STRIP_SUFFIXES = (".png", ".webp")
"""Formats of still pictures."""

MOST_HELD_BYTES = 600 * MEGABYTE
"""Largest memory of the frames of a WebP or GIF, which are written at the end; those of an MP4 are not held."""

COLOR_COUNT = 255
"""Colours of a GIF; one more marks what did not change."""

WEBP_QUALITY = 82
"""Quality of WebP, from 0 to 100."""

MP4_OPTIONS = (
    "-crf",
    "20",
    "-threads",
    "1",
    "-fflags",
    "+bitexact",
    "-movflags",
    "+faststart",
    "-f",
    "mp4",
)
"""Options of ffmpeg: one thread and no date give the same file for the same frames."""

PALETTE_FRAMES = 4
"""Frames that a palette is chosen from."""


class FilmWriter(Protocol):
    """Receiver of the frames of a film."""

    def add(self, frame: NDArray[np.uint8], *, times: int = 1) -> None:
        """Add a picture, shape [height, width, 3], for a number of frames."""


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
    with _written(file) as part:
        if file.suffix.lower() == ".mp4":
            with _mp4_writer(part, size, fps) as writer:
                yield writer
        else:
            writer = _PictureWriter(file.suffix.lower() == ".gif", fps)
            yield writer
            writer.save(part)


def save_still(picture: NDArray[np.uint8], file: Path) -> Path:
    """Write a picture, shape [height, width, 3], whole or not at all, and return its path."""
    check_suffix(file, STRIP_SUFFIXES)
    with _written(file) as part:
        image = Image.fromarray(picture)
        if file.suffix.lower() == ".webp":
            image.save(part, format="WEBP", quality=WEBP_QUALITY, method=6)
        else:
            image.save(part, format="PNG", optimize=True)
    return file


def check_film_format(file: Path) -> None:
    """Check that films of the format of a file can be written here."""
    check_suffix(file, FILM_SUFFIXES)
    if file.suffix.lower() != ".mp4":
        return
    with needs_extra("an MP4 film (a WebP or GIF needs no FFmpeg)", "video"):
        import imageio_ffmpeg
    try:
        imageio_ffmpeg.get_ffmpeg_exe()
    except RuntimeError as error:
        raise VideoError(
            f"there is no ffmpeg: {error} Or write a .webp or .gif"
        ) from error


def check_suffix(file: Path, known: tuple[str, ...]) -> None:
    """Check that the suffix of a file names a known format."""
    if file.suffix.lower() not in known:
        raise ParameterError(
            f"{file}: the suffix states the format: choose {', '.join(known[:-1])} or {known[-1]}"
        )


@contextmanager
def _written(file: Path) -> Iterator[Path]:
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with replaced_whole(file) as part:
            yield part
    except ResultFileError:
        raise
    except OSError as error:
        raise ResultFileError(
            f"{file}: cannot be written: {error.strerror or error}"
        ) from error


@contextmanager
def _mp4_writer(file: Path, size: tuple[int, int], fps: float) -> Iterator[FilmWriter]:
    import imageio_ffmpeg

    try:
        stream = imageio_ffmpeg.write_frames(
            str(file),
            size,
            fps=fps,
            codec="libx264",
            macro_block_size=2,
            ffmpeg_log_level="error",
            output_params=list(MP4_OPTIONS),
        )
        stream.send(None)
    except (OSError, RuntimeError) as error:
        raise VideoError(
            f"ffmpeg does not start: {error}; set IMAGEIO_FFMPEG_EXE, or write a .webp or .gif"
        ) from error
    try:
        yield _StreamWriter(stream)
    finally:
        stream.close()
    if not file.is_file() or file.stat().st_size == 0:
        raise VideoError("ffmpeg has written nothing; write a .webp or .gif instead")


class _StreamWriter:
    """Writer of frames that ffmpeg takes one by one."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def add(self, frame: NDArray[np.uint8], *, times: int = 1) -> None:
        """Add a picture for a number of frames."""
        for _ in range(times):
            try:
                self._stream.send(np.ascontiguousarray(frame))
            except OSError as error:
                raise VideoError(f"ffmpeg has stopped: {error}") from error


class _PictureWriter:
    """Writer of WebP and GIF, whose frames are written together."""

    def __init__(self, is_gif: bool, fps: float) -> None:
        self._is_gif, self._fps = is_gif, fps
        self._frames: list[Image.Image] = []
        self._counts: list[int] = []

    def add(self, frame: NDArray[np.uint8], *, times: int = 1) -> None:
        """Add a picture for a number of frames."""
        if (len(self._frames) + 1) * frame.nbytes > MOST_HELD_BYTES:
            raise ParameterError(
                f"after {len(self._frames)} frames the film takes {MOST_HELD_BYTES // MEGABYTE} MB of memory: give a "
                "smaller width, height or fps, a shorter span, or write an .mp4, which holds one frame"
            )
        self._frames.append(Image.fromarray(frame))
        self._counts.append(times)

    def save(self, file: Path) -> None:
        """Write the frames."""
        # Files count in 10 ms (GIF) or 1 ms: rounding the ends, and not the lengths, keeps the clock.
        tick_ms = 10 if self._is_gif else 1
        ends = (
            np.rint(
                np.cumsum([0, *self._counts]) * 1000.0 / self._fps / tick_ms
            ).astype(int)
            * tick_ms
        )
        first, *rest = _in_one_palette(self._frames) if self._is_gif else self._frames
        options: dict[str, Any] = {"quality": WEBP_QUALITY, "method": 4}
        if self._is_gif:
            options = {"disposal": 1, "optimize": False}
        options |= {
            "save_all": True,
            "append_images": rest,
            "duration": np.diff(ends).tolist(),
            "loop": 0,
        }
        first.save(file, format="GIF" if self._is_gif else "WEBP", **options)


def _in_one_palette(frames: list[Image.Image]) -> list[Image.Image]:
    """Return frames with the colours of a palette that they share, so that what stands still keeps its colour."""
    chosen = [
        frames[index]
        for index in np.linspace(0, len(frames) - 1, PALETTE_FRAMES).round().astype(int)
    ]
    samples = Image.fromarray(np.concatenate([np.asarray(frame) for frame in chosen]))
    palette = samples.quantize(COLOR_COUNT, method=Image.Quantize.MEDIANCUT)
    return [
        frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames
    ]
