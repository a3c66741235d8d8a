"""Write a page for each family of experiments, `docs/environments/`, draw its picture, and write `gauge list`.

Pages need no engine. To draw a picture anew, delete it first.
"""

from __future__ import annotations

import json
import math
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from PIL import Image

from gauge_envs import find_variant, variants
from gauge_envs.envs.env import GaugeEnv
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.experiments.task_files import task_spec
from gauge_envs.pages.markdown import as_markdown
from gauge_envs.references.band import Band
from gauge_envs.references.kind import Kind
from gauge_envs.rendering.reference_path import reference_path, reference_words
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.scoring.reference import reference_kind
from scripts.environment_page import (
    READING,
    Members,
    described_families,
    family_document,
)
from scripts.generated import ROOT, markdown_table, page_part

SCRIPT = f"scripts/{Path(__file__).name}"
PAGES = ROOT / "docs" / "environments"
PICTURES = ROOT / "docs" / "images" / "environments"
FAMILIES = ROOT / "gauge_envs" / "tools" / "catalog" / "families.json"
CAPTIONS = PICTURES / "captions.json"

INTRODUCTION = """
After this page you can choose an experiment. Each family has a page; [How to read these pages](reading.md) has their
terms. Below a picture stand the [kinds of the references](../coverage.md) of its ids. The [gallery](../gallery.md)
shows control tasks.
""".strip()
COLUMNS, README_COLUMNS = 3, 6
"""Pictures in a row of the list, and in a row of the README."""

BEYOND = "Beyond the benchmark"

SIZE = (288, 216)
"""Width and height of a picture [pixels]."""

FPS = 10.0
MAX_FRAMES = 36
FILM_QUALITY = 35
"""Quality of the frames of a picture in WebP, which makes it small."""


@dataclass(frozen=True)
class Entry:
    """Content of the picture of a family, on MuJoCo.

    Attributes:
        name: Variant.
        to_s: Time of the last frame [s]; None for the end of the episode.
        camera: Entries that replace entries of the environment's camera, which leaves room for any initial state.
    """

    name: str
    to_s: float | None = None
    camera: Mapping[str, float] = field(default_factory=dict)


GROUPS: dict[str, tuple[Entry, ...]] = {
    "Rigid bodies": (
        Entry("SlopeSlider-2-wood"),
        Entry("SlopeContact-wood"),
        Entry("NonsmoothContact-1-wood"),
        Entry("Turntable-3-metal"),
        Entry("BouncingBall-rubber"),
        Entry("NewtonsCradle-metal", 0.6),
        Entry("Pendulum-metal", 0.9),
        Entry("WallBreaking-wood", 1.5),
    ),
    "Rope and textiles": (
        Entry("RopeWinding-rubber", 2.0),
        Entry("TextileStretching-satin", 3.0),
        Entry("TextileBending-oxford", 4.8),
        Entry("TextileFlinging-oxford", 1.8),
        Entry("Funnel-satin", 2.0),
        Entry("RotatingBall-uniform", 2.0),
        Entry("TableclothPulling-metal", 3.0, {"distance_m": 2.0}),
    ),
    "Foam": (
        Entry("FoamStretching-soft", 0.9),
        Entry("FoamCompressing-soft", 0.9),
        Entry("FoamShearing-soft", 1.2),
        Entry("FoamTwisting-soft", 2.1),
        Entry("FoamBending-soft", 1.1),
        Entry("StickStack-soft", 4.0, {"distance_m": 0.85}),
        Entry("CantileverBeam-soft", 0.5, {"distance_m": 0.62}),
    ),
    BEYOND: (
        Entry("CubeToss-acrylic", camera={"distance_m": 1.3}),
        Entry("SiliconeBeam-52g-silicone", 0.5),
        Entry("CubePush-light"),
        Entry("ObliqueBounce-nospin"),
        Entry("StripBending-satin", 3.2),
        Entry("BiasStretching-satin", 0.3),
    ),
}

ENTRIES = {
    find_variant(entry.name).family: entry
    for entries in GROUPS.values()
    for entry in entries
}
"""Content of the picture of each family: the variant and the time."""


def picture_of(family: str) -> Path:
    """Return the file of the picture of a family."""
    return PICTURES / f"{family}.webp"


def captions() -> dict[str, str]:
    """Return the caption of each picture as it was drawn, by family."""
    known: dict[str, str] = {}
    if CAPTIONS.is_file():
        known = json.loads(CAPTIONS.read_text(encoding="utf-8"))
    return known


def stride_of(entry: Entry, frame_count: int) -> tuple[int, int]:
    """Return the last frame that a picture shows, and the frames between two of its frames."""
    last = frame_count - 1
    if entry.to_s is not None:
        last = min(round(FRAME_RATE_HZ * entry.to_s), last)
    return last, math.ceil(last / MAX_FRAMES)


def caption_of(entry: Entry, experiment: Experiment, band: Band | None) -> str:
    """Return the caption of the picture of an entry."""
    last, stride = stride_of(entry, experiment.frame_count)
    end_s = last / FRAME_RATE_HZ
    reference = reference_text(experiment, band, end_s=end_s)
    speed = stride * FPS / FRAME_RATE_HZ
    caption = f"{entry.name}, {end_s:.2f} s, speed x {speed:.2g}"
    if reference:
        caption += f"; red: {reference}"
    return f"{caption}."


def reference_text(experiment: Experiment, band: Band | None, *, end_s: float) -> str:
    """Return the text on the reference in a picture; empty without a reference.

    Args:
        experiment: The experiment.
        band: Its reference, or None.
        end_s: Time of the last frame [s]. A reference that ends before it has its end in the text.
    """
    path = reference_path(experiment, band)
    if band is None or path is None:
        return ""
    text = reference_words(band.kind, band.trial_count)
    if experiment.trial is not None:
        text = f"real trial {experiment.trial}"
    if not path.is_full:
        text += ", in the measured directions"
    known = np.isfinite(path.places_m).all(axis=2)
    last_s = np.nonzero(known)[0].max(initial=0) / FRAME_RATE_HZ
    if last_s < end_s - 0.5 / FRAME_RATE_HZ:
        text += f", until {last_s:.2f} s"
    return text


def draw(entry: Entry, file: Path) -> str:
    """Run an episode on MuJoCo with zero actions, draw it with its reference, and return the caption."""
    width, height = SIZE
    env = GaugeEnv(
        entry.name,
        render_mode="rgb_array",
        width=width,
        height=height,
        camera=entry.camera,
        render_overlay=True,
    )
    env.reset(seed=0)
    last, stride = stride_of(entry, env.experiment.frame_count)
    zero: Any = 0
    if not isinstance(env.action_space, spaces.Discrete):
        zero = np.zeros(env.action_space.shape)
    pictures, durations_ms = [], []
    for frame in range(last + 1):
        if frame:
            env.step(zero)
        if frame % stride == 0:
            picture = env.render()
            assert picture is not None
            pictures.append(Image.fromarray(picture))
            # The last picture stays for a second.
            durations_ms.append(1000 if frame + stride > last else round(1000 / FPS))
    env.close()
    pictures[0].save(
        file,
        "WEBP",
        save_all=True,
        append_images=pictures[1:],
        duration=durations_ms,
        loop=0,
        quality=FILM_QUALITY,
        method=6,
        minimize_size=True,
    )
    return caption_of(entry, env.experiment, env.band)


def draw_missing() -> None:
    """Draw the missing pictures; an interrupted picture is drawn next time."""
    for family, entry in ENTRIES.items():
        file = picture_of(family)
        if not file.is_file():
            known = captions() | {family: draw(entry, file)}
            CAPTIONS.write_text(
                json.dumps(known, indent=1, sort_keys=True) + "\n", encoding="utf-8"
            )
            print(f"{file.name}: {file.stat().st_size // 1000} kB", file=sys.stderr)


# --- pages -----------------------------------------------------------------------------------------------------------


def enclosed(text: str) -> str:
    """Return the text of a page between the marks of generated files."""
    return f"<!-- page, written by {SCRIPT} -->\n\n{text}\n<!-- end of page -->\n"


def contents() -> dict[Path, str]:
    """Return every page with its text."""
    families = described_families()
    shown = captions()
    pages = {PAGES / "index.md": enclosed(index_text(families))}
    pages[FAMILIES] = family_rows()
    script = "scripts/build_environments.py"
    pages |= page_part(ROOT / "README.md", "experiments", script, grid_text())
    for family, members in families.items():
        picture = f"../images/environments/{family}.webp"
        caption = shown.get(family, "")
        document = family_document(family, members, picture=picture, caption=caption)
        pages[PAGES / f"{family}.md"] = enclosed(as_markdown(document))
    return pages


def family_rows() -> str:
    """Return name, kinds of the references and evaluated quantities of each family of the benchmark, in JSON."""
    kinds: dict[str, Counter[str]] = {}
    for variant in variants():
        kind = reference_kind(variant.name).value
        kinds.setdefault(variant.family, Counter())[kind] += 1
    rows = []
    for family, counts in kinds.items():
        by_kind = ", ".join(f"{count} {kind}" for kind, count in counts.items())
        rows.append((family, by_kind, ", ".join(task_spec(family).evaluates)))
    return json.dumps(rows, indent=0) + "\n"


def picture_table(cells: Sequence[str], columns: int) -> Sequence[str]:
    """Return the lines of a table of pictures, with empty cells at its end."""
    padded = [*cells, *[""] * (-len(cells) % columns)]
    rows = [padded[first : first + columns] for first in range(0, len(padded), columns)]
    return markdown_table([""] * columns, rows)


def grid_text() -> str:
    """Return the pictures of the benchmark's families for the README, each with a link to its page."""
    cells = []
    for title, entries in GROUPS.items():
        for entry in entries if title != BEYOND else ():
            family = find_variant(entry.name).family
            picture = f"![{family}](docs/images/environments/{family}.webp)"
            cells.append(f"[{picture}<br>{family}](docs/environments/{family}.md)")
    return "\n".join(picture_table(cells, README_COLUMNS))


def index_text(families: Mapping[str, Members]) -> str:
    """Return the list of all families with their pictures."""
    lines = ["# Experiments", "", INTRODUCTION, ""]
    for title, entries in GROUPS.items():
        lines += [f"## {title}", ""]
        cells = []
        for entry in entries:
            family = find_variant(entry.name).family
            cells.append(index_cell(family, families[family]))
        lines += [*picture_table(cells, COLUMNS), ""]
    names = [READING.removesuffix(".md"), *families]
    return "\n".join([*lines, "```{toctree}", ":hidden:", "", *names, "```", ""])


def index_cell(family: str, members: Members) -> str:
    """Return picture, name and numbers of a family, with a link to its page."""
    kinds = Counter(Kind(values["reference"]["kind"]) for values in members.values())
    count = ", ".join(f"{kinds[kind]} x {kind.value}" for kind in Kind if kinds[kind])
    return f"[![{family}](../images/environments/{family}.webp)]({family}.md) [{family}]({family}.md): {count}"
