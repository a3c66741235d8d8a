"""A text that is no path, id or engine gives one sentence and exit code 2, for every command that reads one."""

import os

import pytest

IDS = ["SlopeSlider-2-oak"] * 20

TEXTS = {
    "a long name": "x" * 300,
    "a long path": "/".join(["x" * 200] * 30),
    "a long list": ",".join(IDS),
    "a long list with blanks": " ".join(IDS),
    "a long list with lines": "\n".join(IDS),
    "a long task file": "x" * 300 + ".toml",
    "a long model": "x" * 300 + ".xml",
    "a long result": "x" * 300 + ".json",
    "a newline": "a\nb",
    "commas": ",,,",
    "a home folder": "~nobody-of-this-name/x",
    "a task file in a home folder": "~nobody-of-this-name/x.toml",
    "a folder": "folder",
    "a folder with the suffix of a task": "folder.toml",
    "a pipe": "pipe",
    "a pipe with the suffix of a task": "pipe.toml",
    "a pipe with the suffix of a trajectory": "pipe.npz",
    "letters": "schr\xe4ge\u202e\U0001f642",
    "a broken character": "\udcff",
}

COMMANDS = {
    "run": ("run",),
    "scene": ("run", "SlopeSlider-2-wood", "--asset"),
    "show": ("show",),
    "list": ("list", "experiments"),
    "score": ("score", "--id", "SlopeSlider-2-wood"),
    "compare": ("compare",),
    "plot": ("plot",),
    "report": ("report", "--out", "site"),
    "sweep": ("sweep", "--dry-run"),
    "sweep of ids": ("sweep", "--dry-run", "--only"),
    "sanity": ("sanity",),
    "replay": ("replay", "robot.xml"),
    "versions": ("backend", "versions"),
    "check": ("backend", "check"),
    "import": ("data", "import"),
}


needs_pipes = pytest.mark.skipif(
    not hasattr(os, "mkfifo"), reason="the system has no named pipes"
)


@pytest.fixture
def places(tmp_path):
    """Make a folder and a pipe with the suffixes of files."""
    for suffix in ("", ".toml"):
        (tmp_path / f"folder{suffix}").mkdir()
    for suffix in ("", ".toml", ".npz"):
        os.mkfifo(tmp_path / f"pipe{suffix}")


@needs_pipes
@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("title", TEXTS)
def test_a_text_that_names_nothing_gives_one_sentence(gauge, places, title, command):
    result = gauge(*COMMANDS[command], TEXTS[title])
    assert isinstance(result.exception, SystemExit), result.exception
    assert result.exit_code == 2
    said = result.stderr.strip()
    assert said
    assert "Traceback" not in said


@needs_pipes
def test_a_folder_of_results_may_hold_a_pipe(gauge, tmp_path):
    os.mkfifo(tmp_path / "pipe.json")
    result = gauge("compare", ".")
    assert result.exit_code == 2
    assert "holds no result files" in result.stderr


def test_fourteen_ids_may_be_one_argument(gauge):
    ids = ["SlopeSlider-2-wood", "SlopeSlider-2-metal"] * 7
    result = gauge("list", "experiments", ",".join(ids), "--json")
    assert result.exit_code == 0, result.output
    assert len(result.stdout.splitlines()) == 2
