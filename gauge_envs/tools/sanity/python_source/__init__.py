"""Values that packages state in their Python source, read without importing the packages."""

from gauge_envs.tools.sanity.python_source.source import Source
from gauge_envs.tools.sanity.python_source.values import UNKNOWN, Config, External, Instance, Known, Unknown

__all__ = ["UNKNOWN", "Config", "External", "Instance", "Known", "Source", "Unknown"]
