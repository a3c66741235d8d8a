"""Import packages of extras."""

from collections.abc import Iterator
from contextlib import contextmanager

from gauge_envs.errors import MissingExtraError


@contextmanager
def needs_extra(feature: str, extra: str) -> Iterator[None]:
    """Turn a failed import into an error that names the extra to install.

    Args:
        feature: Feature that needs it, as `plotting`.
        extra: Extra of this package.

    Raises:
        MissingExtraError: A package is not installed.
    """
    try:
        yield
    except MissingExtraError:
        raise
    except ImportError as error:
        raise MissingExtraError(feature, extra, error) from error
