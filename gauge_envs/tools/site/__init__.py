"""Write results as a static site that needs no server and no network."""

from typing import TYPE_CHECKING

from gauge_envs.registry import lazy_names

if TYPE_CHECKING:
    from gauge_envs.tools.site.build import save_site as save_site
else:
    __getattr__, __all__ = lazy_names(__name__, {".build": ["save_site"]})
