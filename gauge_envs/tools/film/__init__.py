"""Films and strips of results: engines side by side, each with the reference that it is scored against."""

from typing import TYPE_CHECKING

from gauge_envs.registry import door

if TYPE_CHECKING:
    from gauge_envs.tools.film.writer import film_writer as film_writer
else:
    __getattr__, __all__ = door(__name__)
