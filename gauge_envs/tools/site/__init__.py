"""Results as a static site: pages that open from a folder, without a server and without the network."""

from typing import TYPE_CHECKING

from gauge_envs.registry import door

if TYPE_CHECKING:
    from gauge_envs.tools.site.build import (
        ReplayNote as ReplayNote,
        save_site as save_site,
    )
else:
    __getattr__, __all__ = door(__name__)
