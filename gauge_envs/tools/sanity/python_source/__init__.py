"""Values that packages state in their Python source, read without importing the packages."""

from gauge_envs.tools.sanity.python_source.source import Source, package_folder, package_version, source_tree
from gauge_envs.tools.sanity.python_source.values import (
    UNKNOWN,
    Config,
    External,
    Function,
    Instance,
    Known,
    Module,
    PythonClass,
    Unknown,
    plain,
    source_path,
)

__all__ = [
    "UNKNOWN",
    "Config",
    "External",
    "Function",
    "Instance",
    "Known",
    "Module",
    "PythonClass",
    "Source",
    "Unknown",
    "package_folder",
    "package_version",
    "plain",
    "source_path",
    "source_tree",
]
