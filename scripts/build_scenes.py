"""Write every scene as USD and MJCF, and every solid as OBJ, as `gauge data scenes` does."""

from __future__ import annotations

from gauge_envs.tools.assets.build import assets_folder, build_assets
from scripts.generated import Request


def measure(request: Request) -> None:
    """Write the files."""
    build_assets(assets_folder())
