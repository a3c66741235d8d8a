"""Write the table of coverage in `docs/coverage.md`: what each id is measured against and driven by in the package.

    python scripts/build_coverage.py            writes it
    python scripts/build_coverage.py --check    fails when it is not current

The table leaves out imported trials, which differ between users: `gauge data status` reports those.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gauge_envs import load_experiment
from gauge_envs.experiments.variants import Variant, variants
from gauge_envs.references.bands import Band, BandGrade, bundled_band
from gauge_envs.references.published import law_for, published_baselines

BEGIN, END = "<!-- coverage, written by scripts/build_coverage.py -->", "<!-- end of coverage -->"
"""Lines of the page that enclose the table."""

HEAD = """
| column | meaning |
| --- | --- |
| band | grade of the best band in the package; *withheld* where nothing is scored on it unless you ask for it |
| known | frames with a known mean, of all frames of the experiment; in brackets, frames known in every coordinate |
| sigma | source of the scatter: the `trials`, the published `baseline`, or the uncertainty of the `measurement` |
| driver | source of the motion of the driven body; `-` where nothing is driven |
| normalized | scores that are divided by the published score of real trials; `no` without a band or a published score |

A law states every frame.
"""
GRADES = (BandGrade.TRIALS, BandGrade.RECORDING, BandGrade.LAW, BandGrade.NONE)


@dataclass(frozen=True)
class Row:
    """Coverage of one variant; each field is what its column says."""

    variant: str
    grade: BandGrade
    withheld: str | None
    known: str
    sigma: str
    driver: str
    normalized: str

    @property
    def used(self) -> BandGrade:
        """Grade of what is scored on."""
        if self.withheld is None:
            return self.grade
        return BandGrade.NONE if law_for(self.variant) is None else BandGrade.LAW

    def cells(self) -> list[str]:
        """Cells of the table."""
        band = f"{self.grade.value}, *withheld*" if self.withheld else self.grade.value
        return [self.variant, band, self.known, self.sigma, self.driver, self.normalized]


def coverage(variant: Variant) -> Row:
    """Return what the package holds for one variant."""
    experiment = load_experiment(variant)
    band, law = bundled_band(variant.name), law_for(variant.name)
    grade = band.grade if band is not None else BandGrade.NONE if law is None else BandGrade.LAW
    withheld = None if band is None else band.withheld
    scored = law is not None or (band is not None and withheld is None)
    baselines = published_baselines(variant.name)
    metrics = [metric for metric in baselines if baselines[metric].mean and (scored or metric not in ("rmse", "dtw"))]
    return Row(
        variant=variant.name,
        grade=grade,
        withheld=withheld,
        known=f"{known_frames(band)} of {experiment.frame_count}"
        if band is not None
        else "-"
        if law is None
        else "all",
        sigma=band.sigma_source.value if band is not None else "-" if law is None else "baseline",
        driver=experiment.driver_provenance or "-",
        normalized=", ".join(metric.upper() for metric in metrics) or "no",
    )


def known_frames(band: Band) -> str:
    """Count the frames at which a band has a mean, and, where fewer, those with a mean in every coordinate."""
    known = np.isfinite(band.mean)
    some, full = known.any(axis=1).sum(), known.all(axis=1).sum()
    return str(some) if full == some else f"{some} ({full} in full)"


def table(titles: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Yield the lines of a Markdown table."""
    for cells in (titles, ["---"] * len(titles), *rows):
        yield f"| {' | '.join(cells)} |"


def coverage_markdown(rows: Sequence[Row]) -> str:
    """Return the text of the block."""
    count = Counter((row.grade, row.used) for row in rows)
    drivers = Counter(row.driver for row in rows)
    lines = [HEAD.strip(), "", f"{len(rows)} ids:", ""]
    lines += [f"- {grade.value}: {count[grade, grade]} scored on" for grade in GRADES[:-1]]
    lines += [
        f"- recording, withheld: {sum(row.withheld is not None for row in rows)}",
        f"- none: {count[BandGrade.NONE, BandGrade.NONE]}",
        f"- drivers: {', '.join(f'{drivers[name]} {name}' for name in sorted(drivers) if name != '-')}",
        "",
        *table(("id", "band", "known", "sigma", "driver", "normalized"), [row.cells() for row in rows]),
        "",
        "Why bands are withheld:",
        "",
    ]
    reasons: dict[str, list[str]] = {}
    for row in rows:
        if row.withheld:
            reasons.setdefault(row.withheld, []).append(row.variant)
    lines += [f"- {', '.join(names)}: {reason}." for reason, names in reasons.items()]
    return "\n".join(lines)


def with_block(page: str, block: str) -> str:
    """Put the block between the two marks of a page.

    Raises:
        ValueError: The page does not have the marks, once each and in order.
    """
    head, begin, rest = page.partition(BEGIN)
    _, end, tail = rest.partition(END)
    if not (begin and end):
        raise ValueError(f"the page needs the lines {BEGIN!r} and {END!r}")
    return f"{head}{BEGIN}\n\n{block}\n\n{END}{tail}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Write or check the file.

    Returns:
        Exit status: 1 when a check found it not current.
    """
    parser = argparse.ArgumentParser(description="Write the table of coverage.")
    parser.add_argument("--check", action="store_true", help="write nothing; fail when the file is not current")
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "docs" / "coverage.md", help="file")
    options = parser.parse_args(arguments)
    page = options.out.read_text(encoding="utf-8")
    text = with_block(page, coverage_markdown([coverage(variant) for variant in variants()]))
    if not options.check:
        options.out.write_text(text, encoding="utf-8", newline="\n")
        return 0
    if page == text:
        return 0
    print(f"{options.out} is not current: run python scripts/build_coverage.py", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
