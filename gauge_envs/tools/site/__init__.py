"""Results as a static site: pages that open from a folder, without a server and without the network."""

from typing import TYPE_CHECKING

from gauge_envs.tools import door

if TYPE_CHECKING:
    from gauge_envs.tools.site.build import ReplayNote, save_site

__all__ = ["ReplayNote", "save_site"]

if not TYPE_CHECKING:  # With it, a type checker would accept any name.
    __getattr__ = door(__name__, "build")
