"""Fetch what a video model is given: the first frame and the prompt of each task, from the benchmark's repository.

They are files of the benchmark and no part of this package. `scoring/published/world_model_inputs.csv` states where
each one is, its size and its hash.
"""

import hashlib
from collections.abc import Callable
from functools import cache, partial
from http.client import HTTPException
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from string import Template
from urllib.error import HTTPError, URLError
from urllib.parse import quote
from urllib.request import Request, urlopen

from gauge_envs.errors import DatasetError, ParameterError
from gauge_envs.files import MEGABYTE, os_errors, read_regular, write_whole
from gauge_envs.references.tables import FileModel, read_rows, scoring_folder

REPOSITORY = "https://github.com/InternRobotics/GAUGE"
"""Repository of the benchmark (MIT licence)."""

COMMIT = "7b36d9b42be95da33c5496b3fe015412c079735a"
"""Commit of the repository whose files are fetched."""

SOURCE = f"https://raw.githubusercontent.com/InternRobotics/GAUGE/{COMMIT}"
"""Address below which the files of that commit lie."""

NOTE = "world_model_inputs.md"
"""Name of the note beside the inputs; it is written last, so a folder that holds it is complete."""

BY_HAND = (
    f"without a network, run `git clone {REPOSITORY}` and `git checkout {COMMIT}` elsewhere, bring its folder `input` "
    "here, and give the folder that holds it as source; files that are complete are kept"
)

TIMEOUT_S = 30.0
"""Longest wait for an answer or for the next bytes [s]."""

WOOD_PROMPT = "SlopeSlider-2-wood.txt"
PLASTIC_PROMPT = "SlopeSlider-2-plastic.txt"

PLASTIC_CHANGES = (
    ("90g wood cube", "147g black plastic cube"),
    ("between wood and wood is 0.27", "between plastic and wood is 0.28"),
    ("for the cube is 0.22", "for the cube is 0.38"),
)
"""What differs between the prompts for the wooden and the plastic cube on the slope in the paper (arXiv 2608.05948)."""


class InputFile(FileModel):
    """One file of the inputs.

    Attributes:
        file: Its name here: the id of the task with `.png` for the first frame and `.txt` for the prompt.
        source: Its path in the repository; None for the prompt that is made from another one.
        size_bytes: Its size.
        sha256: Its SHA-256 hash in hexadecimal digits.
    """

    file: str
    source: str | None
    size_bytes: int
    sha256: str

    def fault(self, content: bytes) -> str:
        """Return how a content differs from the file; empty if it is the same."""
        if len(content) != self.size_bytes:
            return f"has {len(content)} bytes, expected {self.size_bytes}"
        found = hashlib.sha256(content).hexdigest()
        return (
            ""
            if found == self.sha256
            else f"has the SHA-256 hash {found}, expected {self.sha256}"
        )


@cache
def input_files() -> tuple[InputFile, ...]:
    """Return the table of all files: first frames, then prompts, then the negative prompt."""
    file = scoring_folder("published") / "world_model_inputs.csv"
    return tuple(
        row for _, row in read_rows(file, list(InputFile.model_fields), InputFile)
    )


def fetch_inputs(
    folder: Path, *, source: str = SOURCE, advance: Callable[[str], None] | None = None
) -> list[Path]:
    """Write the first frames, the prompts and a note to a folder; files that it has are kept and not fetched again.

    Each file is checked by size and hash, and is written whole or not at all. After an error, the same call continues.

    Args:
        folder: Folder to write to; it is made if it is missing.
        source: Address or folder below which the repository's folder `input` lies.
        advance: Called with the name of each file that is there.

    Returns:
        The files that were written.
    """
    is_address = source.lower().startswith(("http://", "https://"))
    if "://" in source and not is_address:
        raise ParameterError(
            f"source {source!r}: give an address that starts with https:// or http://, or a folder"
        )
    if not is_address and not Path(source).is_dir():
        raise ParameterError(f"source {source!r} is no folder: {BY_HAND}")
    read = (
        partial(_download, source.rstrip("/"))
        if is_address
        else partial(_copy, Path(source))
    )
    # Before anything is fetched, all files that are there are checked.
    contents = {
        file.file: content
        for file in input_files()
        if (content := _kept(folder / file.file, file.fault)) is not None
    }
    note = _note().encode()
    has_note = (
        _kept(
            folder / NOTE, lambda content: "" if content == note else "is another note"
        )
        is not None
    )
    written = []
    for file in input_files():
        if file.file not in contents:
            contents[file.file] = _fetched(file, read, contents)
            written.append(_write(folder / file.file, contents[file.file]))
        if advance is not None:
            advance(file.file)
    if not has_note:
        written.append(_write(folder / NOTE, note))
    return written


def _fetched(
    file: InputFile, read: Callable[[InputFile], bytes], contents: dict[str, bytes]
) -> bytes:
    if file.source is not None:
        return read(file)
    text = contents[WOOD_PROMPT].decode("utf-8")
    for wood, plastic in PLASTIC_CHANGES:
        text = text.replace(wood, plastic)
    content = text.encode("utf-8")
    if fault := file.fault(content):
        raise DatasetError(
            f"{file.file}, made from {WOOD_PROMPT}, {fault}: this installation is damaged"
        )
    return content


def _download(source: str, file: InputFile) -> bytes:
    address = f"{source}/{quote(file.source or '')}"
    try:
        request = Request(
            address, headers={"User-Agent": f"gauge-envs/{version('gauge-envs')}"}
        )
        with urlopen(request, timeout=TIMEOUT_S) as response:
            content: bytes = response.read(file.size_bytes + 1)
    except HTTPError as error:
        raise DatasetError(
            f"{address}: the server answers {error.code} {error.reason}; {BY_HAND}"
        ) from error
    except (OSError, HTTPException, ValueError) as error:
        cause = error.reason if isinstance(error, URLError) else error
        raise DatasetError(
            f"{address}: cannot be downloaded: {cause or type(error).__name__}; {BY_HAND}"
        ) from error
    if fault := file.fault(content):
        # One byte more than expected is read, so that a longer answer shows.
        longer = " or more" if len(content) > file.size_bytes else ""
        raise DatasetError(
            f"{address}: {fault}{longer}: the answer is damaged or another file; {BY_HAND}"
        )
    return content


def _copy(source: Path, file: InputFile) -> bytes:
    path = source / (file.source or "")
    with os_errors(
        lambda cause: DatasetError(f"{path}: cannot be read: {cause}; {BY_HAND}")
    ):
        content = read_regular(path, MEGABYTE)
    if fault := file.fault(content):
        raise DatasetError(f"{path}: {fault}; {BY_HAND}")
    return content


def _kept(path: Path, fault_of: Callable[[bytes], str]) -> bytes | None:
    """Return the content of a file that is there already; None if it is missing."""
    with os_errors(
        lambda cause: DatasetError(
            f"{path}: cannot be read: {cause}; name another folder"
        )
    ):
        try:
            content = read_regular(path, MEGABYTE)
        except FileNotFoundError:
            return None
    if fault := fault_of(content):
        raise DatasetError(
            f"{path} {fault}: move it away, or name another folder; no file was changed"
        )
    return content


def _write(path: Path, content: bytes) -> Path:
    with os_errors(lambda cause: DatasetError(f"{path}: cannot be written: {cause}")):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, content)
    return path


def _note() -> str:
    """Return the note: where the files are from, how to use them, and what differs from the repository."""
    rows = "\n".join(
        f"| `{file.file}` | {f'`{file.source}`' if file.source else f'`{WOOD_PROMPT}`, changed'} | {file.size_bytes} "
        f"| `{file.sha256}` |"
        for file in input_files()
    )
    changes = "\n".join(
        f"- `{wood}` is `{plastic}`" for wood, plastic in PLASTIC_CHANGES
    )
    text = (files("gauge_envs.tools.video") / NOTE).read_text(encoding="utf-8")
    return Template(text).substitute(
        repository=REPOSITORY,
        commit=COMMIT,
        plastic=PLASTIC_PROMPT,
        wood=WOOD_PROMPT,
        changes=changes,
        rows=rows,
    )
