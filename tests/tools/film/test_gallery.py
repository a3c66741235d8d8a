"""The gallery shows all films and control tasks, and says so where it does not."""

import shutil

import build_gallery
import pytest
from places import ROOT

PAGE = ROOT / "docs" / "gallery.md"
PICTURES = ROOT / "docs" / "images" / "gallery"


@pytest.fixture
def copied(tmp_path):
    """A page with its pictures."""
    folder = tmp_path / "images" / "gallery"
    shutil.copytree(PICTURES, folder)
    shutil.copy(PAGE, tmp_path / "gallery.md")
    return tmp_path / "gallery.md"


def test_what_is_missing_is_named(copied, capsys):
    folder = copied.parent / "images" / "gallery"
    (folder / "Carry-Limit-wood.webp").unlink()
    (folder / "Push-Limit-wood.webp").write_bytes(b"")
    (folder / "stray.webp").touch()
    text = copied.read_text(encoding="utf-8").replace(
        "(images/gallery/Pendulum-Limit-metal.webp)", "(elsewhere.webp)"
    )
    copied.write_text(text, encoding="utf-8")
    assert build_gallery.main(["--check", "--page", str(copied)]) == 1
    assert capsys.readouterr().err.splitlines() == [
        "Carry-Limit-wood.webp: there is no such picture",
        "Push-Limit-wood.webp: there is no such picture",
        "Pendulum-Limit-metal.webp: the page does not show it",
        "stray.webp: it is in the folder, and no entry names it",
    ]


def test_a_film_that_is_too_large_is_named(copied, monkeypatch):
    monkeypatch.setattr(build_gallery, "MOST_FILM_BYTES", 1000)
    found = build_gallery.faults(
        copied.read_text(encoding="utf-8"), copied.parent / "images" / "gallery"
    )
    assert len([fault for fault in found if "larger than 1000 bytes" in fault]) == len(
        build_gallery.FILMS
    )
