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
        from gauge_envs.cli.output import save_text
        from gauge_envs.tools.cost.figure import save_pareto
        from gauge_envs.tools.cost.pareto import tradeoff
        from gauge_envs.tools.cost.words import pareto_json, pareto_markdown

        found = tradeoff(results)
        for text in found.notes:
            note(text)
        yield save_pareto(found, out / "pareto.png")
        yield save_text(out / "pareto.md", pareto_markdown(found))
        yield save_text(out / "pareto.json", json.dumps(pareto_json(found), indent=1) + "\n")

    return written(), skipped
