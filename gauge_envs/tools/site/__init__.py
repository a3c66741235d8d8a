"""Results as a static site: pages that open from a folder, without a server and without the network."""

from typing import TYPE_CHECKING

from gauge_envs.registry import lazy_names

if TYPE_CHECKING:
    from gauge_envs.tools.site.build import save_site as save_site
else:
    __getattr__, __all__ = lazy_names(__name__, {".build": ["save_site"]})
