"""The inputs of video models, from a copy of the repository that is whole, damaged, incomplete or not there."""

import hashlib
import socket

import pytest

from gauge_envs.errors import DatasetError
from gauge_envs.tools.video import prompts, video_tasks
from gauge_envs.tools.video.prompts import (
    COMMIT,
    NOTE,
    REPOSITORY,
    SOURCE,
    InputFile,
    fetch_inputs,
    input_files,
)

TABLE = input_files()

WOOD = "A 90g wood cube slides. Friction between wood and wood is 0.27; restitution for the cube is 0.22. It is kept."
PLASTIC = (
    "A 147g black plastic cube slides. Friction between plastic and wood is 0.28; "
    "restitution for the cube is 0.38. It is kept."
)

FRAME_SOURCE = "input/first frames/832x480/slope slider/frame(metal).png"


def content(file):
    """Content of a file in a stand-in for the repository, whose own files are no part of this one."""
    texts = {"SlopeSlider-2-wood.txt": WOOD, "SlopeSlider-2-plastic.txt": PLASTIC}
    return texts.get(file.file, f"content of {file.file}, √" * 50).encode()


@pytest.fixture
def source(tmp_path, monkeypatch):
    """A stand-in for the repository as a folder, and its table of files."""
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
    for file in TABLE:
        if file.source:
            path = folder / file.source
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content(file))
    return str(folder)


def names(folder):
    return {path.name for path in folder.iterdir()} if folder.exists() else set()


def test_the_table_has_a_frame_and_a_prompt_of_every_task():
    expected = [task.id + end for end in (".png", ".txt") for task in video_tasks()]
    assert [file.file for file in TABLE] == [*expected, "negative_prompt.txt"]
    assert len({file.sha256 for file in TABLE}) == len(TABLE), (
        "two tasks have the same input"
    )
    assert [file.file for file in TABLE if file.source is None] == [
        "SlopeSlider-2-plastic.txt"
    ]
    assert SOURCE.startswith("https://") and SOURCE.endswith(COMMIT)


def test_all_files_are_fetched_and_again_with_the_same_command(source, tmp_path):
    out, seen = tmp_path / "new" / "inputs", []
    for _ in range(2):
        written = fetch_inputs(out, source=source, advance=seen.append)
        assert set(written) == names(out) == {file.file for file in TABLE} | {NOTE}
    assert seen == [file.file for file in TABLE] * 2
    assert all((out / file.file).read_bytes() == content(file) for file in TABLE)
    # The repository has a wrong prompt of the plastic cube.
    plastic = out / "SlopeSlider-2-plastic.txt"
    assert plastic.read_text() == PLASTIC
    note = " ".join((out / NOTE).read_text().split())
    assert "`SlopeSlider-2-plastic.txt` is not the file of the repository" in note
    assert REPOSITORY in note and COMMIT in note and "MIT licence" in note


def test_a_prompt_that_does_not_become_the_plastic_one_is_refused(
    source, tmp_path, monkeypatch
):
    monkeypatch.setattr(prompts, "PLASTIC_CHANGES", prompts.PLASTIC_CHANGES[:2])
    with pytest.raises(
        DatasetError, match=r"SlopeSlider-2-plastic\.txt, made from .* expected"
    ):
        fetch_inputs(tmp_path / "out", source=source)
    assert not names(tmp_path / "out")


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (None, "cannot be read: "),
        (lambda whole: whole[:-1] + b"!", "has the SHA-256 hash"),
        (lambda whole: whole * 100, "has the SHA-256 hash"),
    ],
)
def test_a_wrong_file_writes_no_file(source, tmp_path, wrong, message):
    file = tmp_path / "a clone" / FRAME_SOURCE
    whole = file.read_bytes()
    file.unlink()
    if wrong is not None:
        file.write_bytes(wrong(whole))
    with pytest.raises(DatasetError, match=message) as caught:
        fetch_inputs(tmp_path / "out", source=source)
    text = str(caught.value)
    assert "/slope%20slider/frame%28metal%29.png" in text
    assert f"git clone {REPOSITORY}" in text and COMMIT in text
    assert not names(tmp_path / "out")


def test_a_server_that_never_answers_is_given_up(tmp_path, monkeypatch):
    monkeypatch.setattr(prompts, "TIMEOUT_S", 0.2)
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"http://127.0.0.1:{silent.getsockname()[1]}"
        with pytest.raises(DatasetError, match="cannot be read: "):
            fetch_inputs(tmp_path, source=address)


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("http://[::1", "cannot be read"),
        ("http://127.0.0.1:port", "cannot be read"),
        ("http://127.0.0.1:{closed}", "refused"),
        ("https://", "cannot be read"),
        ("ftp://host/x", "https://"),
        ("nowhere", "is no folder"),
    ],
)
def test_an_impossible_source_is_named_with_what_to_do(
    tmp_path, gauge, monkeypatch, address, words
):
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        address = address.format(closed=unused.getsockname()[1])
    result = gauge("video", "prompts", address, "--out", "inputs")
    assert result.exit_code == 2
    shown = " ".join(result.stderr.split())
    for part in (address, words, f"git clone {REPOSITORY}"):
        assert part in shown
    assert not (tmp_path / "inputs").exists()


def test_the_command_reads_a_folder_and_reports(source, tmp_path, gauge):
    result = gauge("video", "prompts", source, "--out", tmp_path / "inputs")
    assert (result.exit_code, result.stdout.strip()) == (0, str(tmp_path / "inputs"))
    assert "20 files written" in result.stderr


@pytest.mark.parametrize("name", ["Pendulum-metal.txt", NOTE])
def test_a_file_of_the_user_is_never_replaced(source, tmp_path, name):
    out = tmp_path / "out"
    out.mkdir()
    (out / name).write_text("mine")
    with pytest.raises(DatasetError, match=rf"{name} is another file: move it away"):
        fetch_inputs(out, source=source)
    assert names(out) == {name}
    assert (out / name).read_text() == "mine"
