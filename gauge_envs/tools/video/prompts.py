"""Fetch the inputs of a video model from the benchmark's repository: the first frame and the prompt of each task.

They are files of the benchmark and no part of this package. `scoring/published/world_model_inputs.csv` lists the place,
the size and the hash of each file.
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
"""Commit of the repository whose files are fetched."""

SOURCE = f"https://raw.githubusercontent.com/InternRobotics/GAUGE/{COMMIT}"
"""Address of the files of that commit."""

NOTE = "world_model_inputs.md"
"""Name of the note that is written with the inputs."""

BY_HAND = (
    f"without a network, run `git clone {REPOSITORY}` and `git checkout {COMMIT}` elsewhere, bring its folder `input` "
    "here, and give the folder that contains it as source"
)

TIMEOUT_S = 30.0
"""Longest wait for an answer or for the next bytes [s]."""

WOOD_PROMPT = "SlopeSlider-2-wood.txt"

PLASTIC_CHANGES = (
    ("90g wood cube", "147g black plastic cube"),
    ("between wood and wood is 0.27", "between plastic and wood is 0.28"),
    ("for the cube is 0.22", "for the cube is 0.38"),
)
"""Differences between the prompts for the wooden and the plastic cube on the slope in the paper (arXiv 2608.05948)."""


class InputFile(FileModel):
    """One file of the inputs.

    Attributes:
        file: Its name here: the id of the task with `.png` for the first frame and `.txt` for the prompt.
        source: Its path in the repository; None for the plastic prompt, which is made from the wooden one.
        size_bytes: Its size.
        sha256: Its SHA-256 hash in hexadecimal digits.
    """

    file: str
    source: str | None
    size_bytes: int
    sha256: str


@cache
def input_files() -> tuple[InputFile, ...]:
    """Return the table of all files: first frames, then prompts, then the negative prompt."""
    file = scoring_folder("published") / "world_model_inputs.csv"
    return tuple(read_rows(file, InputFile))


def fetch_inputs(
    folder: Path,
    *,
    source: str = SOURCE,
    advance: Callable[[str], None] = lambda file: None,
) -> list[str]:
    """Write the first frames, the prompts and a note to a folder, and return the names of the files.

    Nothing is written unless all files are fetched and have their hashes.

    Args:
        folder: Folder to write to; it is created if it is missing.
        source: Address or folder that contains the repository's folder `input`.
        advance: Called with the name of each file that is fetched.

    Raises:
        DatasetError: A file cannot be read, has another hash, or would replace another file.
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
                f"{address}: has the SHA-256 hash {digest}, expected {file.sha256}: damaged, or another file; {BY_HAND}"
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
            # A longer answer shows by one byte more than expected.
            content: bytes = response.read(size_bytes + 1)
    except (OSError, HTTPException, ValueError) as error:
        raise DatasetError(f"{address}: cannot be read: {error}; {BY_HAND}") from error
    return content
