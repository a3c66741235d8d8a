"""What `gauge list scenes` prints with `--json`, a line each."""

from typing import TypedDict


class SceneLine(TypedDict):
    """A built file of a scene.

    Attributes:
        file: Its folder and name.
        bytes: Its size.
        of: Id of the experiment, or the names of the bodies, that it shows.
    """

    file: str
    bytes: int
    of: str
