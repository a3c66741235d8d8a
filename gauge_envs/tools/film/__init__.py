"""Films and strips of results: engines side by side, each with the reference that it is scored against."""

from typing import TYPE_CHECKING

from gauge_envs.tools import door

if TYPE_CHECKING:
    from gauge_envs.tools.film.film import FilmOptions, Recording, save_film
    from gauge_envs.tools.film.layout import Caption, PanelText, strip_picture
    from gauge_envs.tools.film.writer import film_writer, save_still

__all__ = [
    "Caption",
    "FilmOptions",
    "PanelText",
    "Recording",
    "film_writer",
    "save_film",
    "save_still",
    "strip_picture",
]

if not TYPE_CHECKING:  # With it, a type checker would accept any name.
    __getattr__ = door(__name__, "film", "layout", "writer")
