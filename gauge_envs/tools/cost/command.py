"""The picture of error over cost, for `gauge plot --kind cost`."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path

from gauge_envs.cli.arguments import split_details
from gauge_envs.cli.output import note
from gauge_envs.cli.results import loaded_results


def draw_cost(sources: Sequence[str], out: Path) -> tuple[Iterator[Path], int]:
    """Write error over cost as a picture, in Markdown and in JSON."""
    files, _ = split_details(sources, {})
    results, skipped = loaded_results(files, with_scene=True)

    def written() -> Iterator[Path]:
        from gauge_envs.pages.document import as_markdown, as_rows, save_file
        from gauge_envs.pages.figures import save_png
        from gauge_envs.tools.cost import draw_pareto, pareto_document, tradeoff

        found = tradeoff(results)
        for text in found.notes:
            note(text)
        document = pareto_document(found)
        yield save_png(draw_pareto(found), out / "pareto.png")
        yield save_file(out / "pareto.md", as_markdown(document))
        yield save_file(out / "pareto.json", json.dumps(as_rows(document)[0], indent=1) + "\n")

    return written(), skipped
