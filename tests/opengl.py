"""What tests of pictures need of the machine."""

from ctypes.util import find_library

import pytest

needs_opengl = pytest.mark.skipif(
    not (find_library("EGL") or find_library("OSMesa")),
    reason="no OpenGL library: the error is tested instead",
)
