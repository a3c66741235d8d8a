"""Build and check the generated assets: every variant as USD and MJCF.

The files in `assets/` are built from the task files and checked in. Other tools open them without gauge-envs. An edited
copy of a USD layer or of an MJCF file can be the scene of an experiment (`experiments.scene_source`).
"""

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np

from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.variants import variants
from gauge_envs.files import data_folder
from gauge_envs.pages.document import save_file
from gauge_envs.tools.assets.export import mjcf_text, usd_layer_text
from gauge_envs.tools.mjcf import NUMBER

RELATIVE_TOLERANCE = 3e-7
"""Relative difference up to which numbers are equal in a check. Sines differ in their last digit between machines, and
USD keeps some values in single precision."""
ABSOLUTE_TOLERANCE = 1e-12


# --- folder ----------------------------------------------------------------------------------------------------------


def assets_folder() -> Path:
    """Return the folder of the checked-in assets, in a checkout and in an installed wheel."""
    return data_folder("tasks").parent / "assets"


def asset_texts(
    advance: Callable[[str], None] = lambda name: None,
) -> Iterator[tuple[str, str]]:
    """Yield the path below the assets folder and the text of every generated file.

    Args:
        advance: Function that is called with the name of each experiment after its files.
    """
    for variant in variants():
        experiment = load_experiment(variant)
        yield f"mjcf/{experiment.name}.xml", mjcf_text(experiment)
        yield f"usd/{experiment.name}.usda", usd_layer_text(experiment)
        advance(experiment.name)


def build_assets(
    folder: Path, texts: Iterable[tuple[str, str]] | None = None
) -> list[Path]:
    """Write generated files, and remove files of earlier builds that are no longer generated.

    Args:
        folder: Folder of the assets.
        texts: Files to write, by default `asset_texts`.

    Returns:
        Paths of the written files.

    Raises:
        ResultFileError: The folder cannot be written.
    """
    written = [save_file(folder / name, text) for name, text in texts or asset_texts()]
    for path in set(_generated(folder)) - set(written):
        path.unlink()
    return written


def stale_asset(
    folder: Path, texts: Iterable[tuple[str, str]] | None = None
) -> Path | None:
    """Return the first file that is missing, differs from its current text, or is no longer generated; else None.

    Files that differ only in the last digits of numbers are equal.
    """
    left_over = set(_generated(folder))
    for name, text in texts or asset_texts():
        path = folder / name
        if path not in left_over:
            return path
        if not _is_same(path.read_text("utf-8", errors="replace"), text):
            return path
        left_over.remove(path)
    return min(left_over, default=None)


def _generated(folder: Path) -> list[Path]:
    return sorted(
        path
        for name in ("mjcf", "usd")
        for path in (folder / name).glob("*")
        if path.is_file()
    )


def _is_same(text: str, expected: str) -> bool:
    """Return whether texts are equal, up to the last digits of their numbers."""
    if text == expected:
        return True
    if NUMBER.split(text) != NUMBER.split(expected):
        return False
    numbers, expected_numbers = (
        np.array(NUMBER.findall(page), dtype=np.float64) for page in (text, expected)
    )
    return np.allclose(
        numbers, expected_numbers, rtol=RELATIVE_TOLERANCE, atol=ABSOLUTE_TOLERANCE
    )
