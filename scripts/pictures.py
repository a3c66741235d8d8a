"""Make pictures of the pages small: 128 colours for a PNG file, a low quality for the frames of a film.

python -m scripts.pictures docs/images/transfer.png
"""

from __future__ import annotations

import io
import sys
from pathlib import Path

from PIL import Image, ImageSequence

COLOURS = 128
FILM_QUALITY = 35


def shrink(file: Path) -> None:
    """Write a picture or a WebP film smaller, in place; sizes and times stay."""
    with Image.open(file) as picture:
        content = _png(picture) if file.suffix == ".png" else _film(picture)
    if len(content) < file.stat().st_size:
        file.write_bytes(content)


def _png(picture: Image.Image) -> bytes:
    method, dither = Image.Quantize.MEDIANCUT, Image.Dither.NONE
    reduced = picture.convert("RGB").quantize(COLOURS, method, kmeans=2, dither=dither)
    stream = io.BytesIO()
    reduced.save(stream, "PNG", optimize=True)
    return stream.getvalue()


def _film(picture: Image.Image) -> bytes:
    frames, durations_ms = [], []
    for frame in ImageSequence.Iterator(picture):
        frames.append(frame.convert("RGB"))
        durations_ms.append(frame.info["duration"])
    stream = io.BytesIO()
    frames[0].save(
        stream,
        "WEBP",
        save_all=True,
        append_images=frames[1:],
        duration=durations_ms,
        loop=picture.info.get("loop", 0),
        quality=FILM_QUALITY,
        method=6,
        minimize_size=True,
    )
    return stream.getvalue()


if __name__ == "__main__":
    for name in sys.argv[1:]:
        shrink(Path(name))
