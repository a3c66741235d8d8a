"""Fetch what a video model is given: the first frame and the prompt of each task, from the benchmark's repository.

They are files of the benchmark and no part of this package. `scoring/published/world_model_inputs.csv` states where
each one is, its size and its hash.
"""

import hashlib
from collections.abc import Callable
from functools import cache
from http.client import HTTPException
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from string import Template
from urllib.error import URLError
from urllib.parse import quote
from urllib.request import Request, urlopen

from gauge_envs.errors import DatasetError, ParameterError
from gauge_envs.files import os_errors, write_whole
from gauge_envs.references.tables import FileModel, read_rows, scoring_folder

REPOSITORY = "https://github.com/InternRobotics/GAUGE"
"""Repository of the benchmark (MIT licence)."""

COMMIT = "7b36d9b42be95da33c5496b3fe015412c079735a"
"""Commit of the repository whose files are fetched."""

SOURCE = f"https://raw.githubusercontent.com/InternRobotics/GAUGE/{COMMIT}"
"""Address below which the files of that commit lie."""

NOTE = "world_model_inputs.md"
"""Name of the note beside the inputs."""

BY_HAND = (
    f"without a network, run `git clone {REPOSITORY}` and `git checkout {COMMIT}` elsewhere, bring its folder `input` "
    "here, and give the folder that holds it as source"
)

TIMEOUT_S = 30.0
"""Longest wait for an answer or for the next bytes [s]."""

WOOD_PROMPT = "SlopeSlider-2-wood.txt"

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
    return tuple(read_rows(file, InputFile))


def fetch_inputs(
    folder: Path, *, source: str = SOURCE, advance: Callable[[str], None] | None = None
) -> list[str]:
    """Write the first frames, the prompts and a note to a folder, once all are fetched and checked by size and hash.

    Args:
        folder: Folder to write to; it is made if it is missing.
        source: Address or folder below which the repository's folder `input` lies.
        advance: Called with the name of each file that is fetched.

    Returns:
        Names of the files.
    """
    if not source.lower().startswith(("https://", "http://")):
        if not Path(source).is_dir():
            raise ParameterError(
                f"source {source!r} is no folder, and no address with https:// or http://: {BY_HAND}"
            )
        source = Path(source).resolve().as_uri()
    contents: dict[str, bytes] = {}
    for file in input_files():
        if file.source is None:
            contents[file.file] = _plastic_prompt(file, contents[WOOD_PROMPT])
        else:
            contents[file.file] = _read(
                f"{source.rstrip('/')}/{quote(file.source)}", file
            )
        if advance is not None:
            advance(file.file)
    note = (files("gauge_envs.tools.video") / NOTE).read_text(encoding="utf-8")
    facts = {"repository": REPOSITORY, "commit": COMMIT}
    contents[NOTE] = Template(note).substitute(facts).encode()
    with os_errors(lambda cause: DatasetError(f"{folder}: cannot be written: {cause}")):
        for name, content in contents.items():
            path = folder / name
            if path.exists() and path.read_bytes() != content:
                raise DatasetError(f"{path} is another file: move it away")
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in contents.items():
            write_whole(folder / name, content)
    return list(contents)


def _plastic_prompt(file: InputFile, wood: bytes) -> bytes:
    text = wood.decode("utf-8")
    for old, new in PLASTIC_CHANGES:
        text = text.replace(old, new)
    content = text.encode("utf-8")
    if fault := file.fault(content):
        raise DatasetError(
            f"{file.file}, made from {WOOD_PROMPT}, {fault}: this installation is damaged"
        )
    return content


def _read(address: str, file: InputFile) -> bytes:
    try:
        request = Request(
            address, headers={"User-Agent": f"gauge-envs/{version('gauge-envs')}"}
        )
        with urlopen(request, timeout=TIMEOUT_S) as response:
            # One byte more than expected, so that a longer answer shows.
            content: bytes = response.read(file.size_bytes + 1)
    except (OSError, HTTPException, ValueError) as error:
        cause = error.reason if isinstance(error, URLError) else error
        raise DatasetError(
            f"{address}: cannot be read: {cause or type(error).__name__}; {BY_HAND}"
        ) from error
    if fault := file.fault(content):
        raise DatasetError(f"{address}: {fault}: damaged, or another file; {BY_HAND}")
    return content
