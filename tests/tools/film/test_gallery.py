"""The gallery shows all films and control tasks."""

import re

from places import ROOT

from scripts import build_gallery

PAGE = ROOT / "docs" / "gallery.md"
PICTURES = ROOT / "docs" / "images" / "gallery"


MOST_FILM_BYTES, MOST_BYTES = 640_000, 4_000_000
"""Largest size of a film, and of all pictures: a page that loads in seconds."""


def test_every_picture_is_on_the_page_and_none_is_left_over():
    wanted = {build_gallery.picture_name(name) for name in build_gallery.CONTROLS}
    films = {build_gallery.film_name(film) for film in build_gallery.FILMS}
    page = PAGE.read_text(encoding="utf-8")
    sizes = {file.name: file.stat().st_size for file in PICTURES.iterdir()}
    assert set(re.findall(r"\]\(images/gallery/([^)]+)\)", page)) == wanted | films
    assert set(sizes) == wanted | films
    assert all(sizes.values())
    assert max(sizes[name] for name in films) <= MOST_FILM_BYTES
    assert sum(sizes.values()) <= MOST_BYTES
