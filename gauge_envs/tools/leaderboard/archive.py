"""The results of a submission in one archive, which `gauge leaderboard check --run` writes."""

import io
import lzma
import tarfile
from collections.abc import Mapping
from pathlib import Path

from gauge_envs.files import MEGABYTE, printable, read_regular, write_whole
from gauge_envs.runs.result_file import MAX_RESULT_BYTES

ARCHIVE = "results.tar.xz"

MAX_TOTAL_BYTES = 256 * MEGABYTE
"""Largest size of all result files; all 75 results of an engine have less than a third of it."""

MAX_DICTIONARY_BYTES = 100 * MEGABYTE
"""Largest memory of the decompressor; `xz -9` needs 65 MB."""


def read_archive(file: Path) -> dict[str, bytes]:
    """Return the contents of the files of an archive by name, as `results/A.mujoco.calibrated.json`.

    Nothing is written, and nothing larger than the limits is unpacked.

    Raises:
        ValueError: It is damaged or too large, or holds anything but regular files.
    """
    content = read_regular(file, MAX_RESULT_BYTES)
    files: dict[str, bytes] = {}
    try:
        stream = lzma.LZMADecompressor(lzma.FORMAT_XZ, MAX_DICTIONARY_BYTES)
        unpacked = stream.decompress(content, MAX_TOTAL_BYTES)
        if not stream.eof:
            limit = MAX_TOTAL_BYTES / MEGABYTE
            raise ValueError(f"one xz stream of at most {limit:.0f} MB is expected")
        with tarfile.open(fileobj=io.BytesIO(unpacked), mode="r:") as archive:
            for member in archive:
                reader = archive.extractfile(member) if member.isreg() else None
                if reader is None or member.issparse():
                    raise ValueError(f"{printable(member.name)} is no regular file")
                files[member.name] = reader.read()
    except (lzma.LZMAError, tarfile.TarError, EOFError) as error:
        raise ValueError(f"not a tar archive compressed by xz: {error}") from error
    return files


def write_archive(file: Path, contents: Mapping[str, bytes]) -> None:
    """Write an archive of files by name; it has no owner and no time, so that equal results give equal bytes."""
    unpacked = io.BytesIO()
    with tarfile.open(fileobj=unpacked, mode="w") as archive:
        for name, content in sorted(contents.items()):
            member = tarfile.TarInfo(name)
            member.size = len(content)
            archive.addfile(member, io.BytesIO(content))
    write_whole(file, lzma.compress(unpacked.getvalue(), preset=9))
