"""Fetch the inputs of a video model, first frames and prompts, from the repository of the benchmark.

The files are not part of this package. `scoring/published/world_model_inputs.csv` lists place, size and hash of each
file.
"""

import hashlib
from collections.abc import Callable
from functools import cache
from http.client import HTTPException
from importlib.resources import files
from pathlib import Path
from urllib.parse import quote
from urllib.request import urlopen

from gauge_envs.errors import DatasetError
from gauge_envs.pages.document import save_file
from gauge_envs.references.tables import FileModel, read_rows, scoring_folder

REPOSITORY = "https://github.com/InternRobotics/GAUGE"
"""Repository of the benchmark (MIT licence)."""

COMMIT = "7b36d9b42be95da33c5496b3fe015412c079735a"
"""Commit of the fetched files."""

SOURCE = f"https://raw.githubusercontent.com/InternRobotics/GAUGE/{COMMIT}"
"""Address of the files of this commit."""

NOTE = "world_model_inputs.md"
"""Name of the note next to the inputs."""

BY_HAND = (
    f"without a network, run `git clone {REPOSITORY}` and `git checkout {COMMIT}` on another machine, copy its folder "
    "`input`, and give the parent folder as source"
)

TIMEOUT_S = 30.0
"""Time limit for an answer or for the next bytes [s]."""

WOOD_PROMPT = "SlopeSlider-2-wood.txt"

PLASTIC_CHANGES = (
    ("90g wood cube", "147g black plastic cube"),
    ("between wood and wood is 0.27", "between plastic and wood is 0.28"),
    ("for the cube is 0.22", "for the cube is 0.38"),
)
"""Differences between the prompts for the wooden and the plastic cube on the slope (arXiv 2608.05948)."""


class InputFile(FileModel):
    """One file of the inputs.

    Attributes:
        file: Name: the id of the task with `.png` for the first frame or `.txt` for the prompt.
        source: Path in the repository; None for the plastic prompt, which derives from the wooden prompt.
        size_bytes: Size [byte].
        sha256: SHA-256 hash in hexadecimal digits.
    """

    file: str
    source: str | None
    size_bytes: int
    sha256: str


@cache
def input_files() -> tuple[InputFile, ...]:
    """Return all files: first frames, prompts, and the negative prompt."""
    file = scoring_folder("published") / "world_model_inputs.csv"
    return tuple(read_rows(file, InputFile))


def fetch_inputs(
    folder: Path,
    *,
    source: str = SOURCE,
    advance: Callable[[str], None] = lambda file: None,
) -> list[str]:
    """Write the first frames, the prompts and a note to a folder, and return the names of the files.

    Files are written only if all files are fetched and have the expected hashes.

    Args:
        folder: Folder of the files, created if it does not exist.
        source: Address or folder that contains the folder `input` of the repository.
        advance: Receives the name of each fetched file.

    Raises:
        DatasetError: A file cannot be read, has a wrong hash, or would replace another file.
        ResultFileError: A file cannot be written.
    """
    if not source.lower().startswith(("https://", "http://")):
        source = Path(source).resolve().as_uri()
    contents = {NOTE: (files("gauge_envs.tools.video") / NOTE).read_bytes()}
    for file in input_files():
        if file.source is None:
            address, text = file.file, contents[WOOD_PROMPT].decode()
            for wood, plastic in PLASTIC_CHANGES:
                text = text.replace(wood, plastic)
            content = text.encode()
        else:
            address = f"{source.rstrip('/')}/{quote(file.source)}"
            content = _read(address, file.size_bytes)
        digest = hashlib.sha256(content).hexdigest()
        if digest != file.sha256:
            raise DatasetError(
                f"{address}: has the SHA-256 hash {digest}, expected {file.sha256}: damaged or wrong file; {BY_HAND}"
            )
        contents[file.file] = content
        advance(file.file)
    for name, content in contents.items():
        path = folder / name
        if path.is_file() and path.read_bytes() != content:
            raise DatasetError(f"{path} is another file: move it away")
        save_file(path, content)
    return list(contents)


def _read(address: str, size_bytes: int) -> bytes:
    try:
        with urlopen(address, timeout=TIMEOUT_S) as response:
            # One extra byte detects a longer answer.
            content: bytes = response.read(size_bytes + 1)
    except (OSError, HTTPException, ValueError) as error:
        raise DatasetError(f"{address}: cannot be read: {error}; {BY_HAND}") from error
    return content
