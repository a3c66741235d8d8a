"""Results as a static site: pages that open from a folder, without a server and without the network."""

from gauge_envs.tools.site.build import ReplayNote, save_site

__all__ = ["ReplayNote", "save_site"]
