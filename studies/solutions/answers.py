"""Write the answers of MuJoCo to all ids, from their results, to `scoring/answers.csv`.

gauge run "*" --out results
python studies/solutions/answers.py results
"""

import csv
import sys
from pathlib import Path

from gauge_envs.experiments.variants import variants
from gauge_envs.files import data_folder
from gauge_envs.pages.text import digits_text, score_text
from gauge_envs.runs.result_file import load_result
from gauge_envs.scoring.score import Score
from gauge_envs.tools.run.report import motion_text

COLUMNS = (
    "id",
    "solves",
    "distance",
    "motion",
    "unit",
    "like_reality",
    "because",
)


def reason(score: Score) -> str:
    """Return what decides whether a motion is like reality: an event, or the distance from real trials."""
    if score.like_reality is None:
        return ""
    if score.real_limit is None:
        return motion_text(score) or ""
    distance, limit = score_text(score.distance), digits_text(score.real_limit)
    text = f"{distance} {score.distance_unit} from real trials; one more trial is within {limit}"
    event = motion_text(score) if score.events else None
    return f"{text}; {event}" if event else text


def row(name: str, score: Score) -> dict[str, str]:
    """Return the answers to one id."""
    return {
        "id": name,
        "solves": score.solves or "no solution",
        "distance": score_text(score.solution_distance),
        "motion": score_text(score.solution_motion),
        "unit": score.distance_unit if score.solution_distance is not None else "-",
        "like_reality": score.like_reality or "-",
        "because": reason(score),
    }


def main(results: Path) -> None:
    """Write the file."""
    scores = {}
    for file in sorted(results.glob("*.json")):
        result = load_result(file)
        scores[result.id.removeprefix("GAUGE/")] = result.score
    names = [variant.name for variant in variants()]
    with (data_folder("scoring") / "answers.csv").open(
        "w", encoding="utf-8", newline=""
    ) as stream:
        writer = csv.DictWriter(stream, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(row(name, scores[name]) for name in names)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
