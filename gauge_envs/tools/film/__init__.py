"""Films and strips of results: engines side by side, each with the reference that it is scored against."""

from typing import TYPE_CHECKING

from gauge_envs.registry import door

if TYPE_CHECKING:
    from gauge_envs.tools.film.film import (
        FilmOptions as FilmOptions,
        Recording as Recording,
        save_film as save_film,
    )
    from gauge_envs.tools.film.layout import (
        Caption as Caption,
        PanelText as PanelText,
        strip_picture as strip_picture,
    )
    from gauge_envs.tools.film.writer import (
        film_writer as film_writer,
        save_still as save_still,
    )
else:
    __getattr__, __all__ = door(__name__)
