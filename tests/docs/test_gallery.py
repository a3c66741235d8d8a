"""The gallery shows all of its pictures."""

import re

from places import ROOT

PAGE = ROOT / "docs" / "gallery.md"
PICTURES = ROOT / "docs" / "images" / "gallery"

MOST_BYTES = 4_000_000
"""Largest size of all pictures: a page that loads in seconds."""


def test_every_picture_is_on_the_page_and_none_is_left_over():
    page = PAGE.read_text()
    sizes = {file.name: file.stat().st_size for file in PICTURES.iterdir()}
    assert set(re.findall(r"\]\(images/gallery/([^)]+)\)", page)) == set(sizes)
    assert all(sizes.values())
    assert sum(sizes.values()) <= MOST_BYTES
