"""List and show experiments and control tasks, for the terminal and the documentation."""

from typing import TYPE_CHECKING

from gauge_envs.tools import door

if TYPE_CHECKING:
    from gauge_envs.tools.catalog.family import family_document

__all__ = ["family_document"]

if not TYPE_CHECKING:  # With it, a type checker would accept any name.
    __getattr__ = door(__name__, "family")
