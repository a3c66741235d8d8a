"""Result files of an accepted submission in one archive, as `tar -cJf results.tar.xz results` makes it."""

import io
import lzma
import re
import tarfile

from gauge_envs.files import MEGABYTE, printable
from gauge_envs.runs.result_file import MAX_RESULT_BYTES

ARCHIVE = "results.tar.xz"

MAX_DICTIONARY_BYTES = 100 * MEGABYTE
"""Largest memory of the decompressor; `xz -9` needs 65 MB."""


def archived_files(content: bytes, most_bytes: int) -> dict[str, bytes]:
    """Return the contents of the result files of an archive, by their name, as `results/A.mujoco.calibrated.json`.

    Nothing is written, and nothing larger than the limits is unpacked.

    Args:
        content: The archive.
        most_bytes: Largest size of all that it holds.

    Raises:
        ValueError: It is damaged, too large, or holds anything but result files.
    """
    files: dict[str, bytes] = {}
    try:
        stream = lzma.LZMADecompressor(lzma.FORMAT_XZ, MAX_DICTIONARY_BYTES)
        unpacked = stream.decompress(content, most_bytes)
        if not stream.eof or stream.unused_data:
            raise ValueError(
                f"one xz stream of at most {most_bytes / MEGABYTE:.0f} MB is expected"
            )
        with tarfile.open(fileobj=io.BytesIO(unpacked), mode="r:") as archive:
            for member in archive:
                if member.isdir() and member.name == "results":
                    continue
                _check_member(member, files)
                reader = archive.extractfile(member)
                assert reader is not None
                files[member.name] = reader.read()
    except (lzma.LZMAError, tarfile.TarError, EOFError) as error:
        raise ValueError(f"not a tar archive compressed by xz: {error}") from error
    return files


def _check_member(member: tarfile.TarInfo, earlier: dict[str, bytes]) -> None:
    name = printable(member.name)
    is_file = member.isreg() and not member.issparse()
    if not is_file or not re.fullmatch(r"results/[^/.][^/]*\.json", member.name):
        raise ValueError(f"{name} is unexpected in it; expected: results/*.json")
    if member.name in earlier:
        raise ValueError(f"{name} is in it twice")
    if member.size > MAX_RESULT_BYTES:
        size, limit = member.size / MEGABYTE, MAX_RESULT_BYTES / MEGABYTE
        raise ValueError(f"{name} has {size:.0f} MB, the limit is {limit:.0f} MB")
