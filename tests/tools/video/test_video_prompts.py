"""The inputs of video models, from a complete, damaged or incomplete copy of the repository."""

import hashlib

import pytest

from gauge_envs.tools.video import prompts
from gauge_envs.tools.video.prompts import COMMIT, NOTE, REPOSITORY, InputFile

TABLE = prompts.input_files()

WOOD = "A 90g wood cube slides. Friction between wood and wood is 0.27; restitution for the cube is 0.22. It is kept."
PLASTIC = (
    "A 147g black plastic cube slides. Friction between plastic and wood is 0.28; "
    "restitution for the cube is 0.38. It is kept."
)


def content(file):
    """Return the content of a file in the replacement of the repository."""
    texts = {"SlopeSlider-2-wood.txt": WOOD, "SlopeSlider-2-plastic.txt": PLASTIC}
    return texts.get(file.file, f"content of {file.file}, √" * 50).encode()


@pytest.fixture
def source(tmp_path, monkeypatch):
    """Return a folder that replaces the repository, and patch the table of files."""
    table = tuple(
        InputFile(
            file=file.file,
            source=file.source,
            size_bytes=len(content(file)),
            sha256=hashlib.sha256(content(file)).hexdigest(),
        )
        for file in TABLE
    )
    monkeypatch.setattr(prompts, "input_files", lambda: table)
    folder = tmp_path / "a clone"
    for file in filter(lambda file: file.source, TABLE):
        path = folder / file.source
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content(file))
    return folder


def test_the_command_writes_all_files_and_the_corrected_prompt_twice(
    source, tmp_path, gauge
):
    out = tmp_path / "inputs"
    for _ in range(2):
        result = gauge("video", "prompts", source, "--out", out)
        assert (result.exit_code, result.stdout.strip()) == (0, str(out))
        assert "20 files written" in result.stderr
    assert {path.name for path in out.iterdir()} == {file.file for file in TABLE} | {
        NOTE
    }
    assert all((out / file.file).read_bytes() == content(file) for file in TABLE)
    note = (out / NOTE).read_text()
    assert REPOSITORY in note and COMMIT in note and "MIT licence" in note


@pytest.mark.parametrize("change", ["missing", "damaged"])
def test_a_wrong_file_is_named_and_no_file_is_written(source, tmp_path, gauge, change):
    file = source / "input/first frames/832x480/slope slider/frame(metal).png"
    named = "/slope%20slider/frame%28metal%29.png"
    if change == "missing":
        file.unlink()
    else:
        file.write_bytes(file.read_bytes() * 100)
    result = gauge("video", "prompts", source, "--out", tmp_path / "out")
    shown = " ".join(result.stderr.split())
    cause = "cannot be read" if change == "missing" else "has the SHA-256 hash"
    assert result.exit_code == 2
    assert all(text in shown for text in (named, cause, f"git clone {REPOSITORY}"))
    assert not (tmp_path / "out").exists()


def test_a_file_of_the_user_is_never_replaced(source, tmp_path, gauge):
    (tmp_path / "Pendulum-metal.txt").write_text("mine")
    result = gauge("video", "prompts", source, "--out", tmp_path)
    assert result.exit_code == 2 and "is another file: move it" in result.stderr
    assert (tmp_path / "Pendulum-metal.txt").read_text() == "mine"
