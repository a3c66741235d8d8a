"""Check what a video lab submits, and rank it between real trials and a still picture."""

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from gauge_envs.files import MEGABYTE, read_regular, toml_document
from gauge_envs.pages.table import Column, Table
from gauge_envs.references.tables import FileModel, faults_of, read_content
from gauge_envs.tools.video.frames import MOST_BYTES
from gauge_envs.tools.video.laws import GRAVITY_M_PER_S2
from gauge_envs.tools.video.prompts import COMMIT
from gauge_envs.tools.video.scoring import VideoScore, way_in_sizes
from gauge_envs.tools.video.tasks import Motion, VideoTask, video_tasks

FILE = "submission.toml"
"""Name of the file in the folder of a model."""

SEEDS = 4
"""Clips of a task, of different seeds."""

NOTE = (
    "Law: how near the values are to it, from 0 to 1; mean over the tasks, each the mean over its clips. A share is "
    "the smaller ratio of a, PD or MTE and its law; R^2; or 1 over 1 and DE in parts of the friction. A clip that is "
    "refused or missing counts 0, as a still picture does. QFI has no share, as it grows with the count of frames."
)


class Submission(FileModel):
    """Content of a submission file.

    Attributes:
        model: Name and version of the model.
        prompts: Commit of the prompts and first frames; that of `gauge video prompts`.
        settings: How the clips were made: steps, guidance, negative prompt.
        seeds: Seeds of the clips `seed_1` and on.
    """

    model: str
    prompts: str
    settings: str
    seeds: list[int]


Results: TypeAlias = Mapping[tuple[str, str], Mapping[Path, VideoScore | None]]
"""Results of the clips by model and task; None for a clip that cannot be judged."""


def law_share(result: VideoScore | None, task: VideoTask) -> float:
    """Return how near a clip is to the law of its task, from 0 to 1; 0 for one that is refused.

    Args:
        result: The result; None for a clip that cannot be judged.
        task: The task.
    """
    if result is None or not result.is_sound:
        return 0.0
    # A cube that stands still needs no force.
    is_still = task.motion is Motion.TURN and way_in_sizes(result.track, task) < 1.0
    shares = []
    for name, law in task.law.items():
        value = result.metrics[name]
        if name == "qfi":
            continue
        if value is None or is_still:
            shares.append(0.0)
        elif name == "de":
            friction_n = task.friction * task.mass_kg * GRAVITY_M_PER_S2
            shares.append(1.0 / (1.0 + value / friction_n))
        elif name == "r2":
            shares.append(max(0.0, value))
        else:
            shares.append(_ratio(value, law))
    return float(np.mean(shares))


def _ratio(value: float, law: float) -> float:
    """Return the smaller ratio of a value and its law, from 0 to 1."""
    ratio = max(0.0, value) / law
    return min(ratio, 1.0 / max(ratio, 1.0))


def submission_faults(folder: Path, clips: Mapping[str, list[Path]]) -> list[str]:
    """Return what a submission lacks.

    Args:
        folder: Folder of the model, with the submission file.
        clips: Its clips by task.

    Raises:
        ReferenceFileError: The file cannot be read, or has another key or type.
    """
    with faults_of(folder / FILE):
        content = read_content(folder / FILE, MEGABYTE)
        submission = Submission.model_validate(toml_document(content))
    faults = []
    if submission.prompts != COMMIT:
        faults.append(
            f"prompts is {submission.prompts}, and gauge video prompts fetches {COMMIT}"
        )
    if len(set(submission.seeds)) != SEEDS:
        faults.append(f"seeds has {len(set(submission.seeds))} numbers, not {SEEDS}")
    file_of_digest: dict[str, Path] = {}
    for task in video_tasks():
        files = clips.get(task.id, [])
        if len(files) != SEEDS:
            faults.append(f"{task.id} has {len(files)} clips, not {SEEDS}")
        for file in files:
            digest = hashlib.sha256(read_regular(file, MOST_BYTES)).hexdigest()
            if digest in file_of_digest:
                first = file_of_digest[digest]
                faults.append(f"{file.name} of {task.id} is {first} again")
            file_of_digest[digest] = file.relative_to(folder)
    return [f"{folder / FILE}: {one}" for one in faults]


def ranking(results: Results, models: list[str]) -> Table:
    """Return the table of submissions, the nearest to the law first, with real trials and a still picture.

    Args:
        results: Results of the clips.
        models: Names of the folders that are submissions.
    """
    rows: list[dict[str, Any]] = []
    for model in models:
        clips = [results.get((model, task.id), {}).values() for task in video_tasks()]
        shares = [
            [law_share(one, task) for one in ones]
            for ones, task in zip(clips, video_tasks(), strict=True)
        ]
        spreads = [np.std(ones, ddof=1) for ones in shares if len(ones) > 1]
        refused = [one is None or not one.is_sound for ones in clips for one in ones]
        rows.append(
            {
                "model": model,
                # A clip that is missing counts 0.
                "law": np.mean([sum(ones) / max(len(ones), SEEDS) for ones in shares]),
                "spread": np.mean(spreads) if spreads else None,
                "refused": np.mean(refused) if refused else 0.0,
                "clips": len(refused),
            }
        )
    trials = [
        _ratio(measured.mean, task.law[name])
        for task in video_tasks()
        for name, measured in task.real.items()
    ]
    rows.append({"model": "real trials", "law": np.mean(trials)})
    rows.append({"model": "still picture", "law": 0.0})
    rows.sort(key=lambda row: -row["law"])
    columns = (
        Column("model", "model"),
        Column("law", "law", "{:.2f}".format, is_number=True),
        Column("spread", "spread over seeds", "{:.2f}".format, is_number=True),
        Column("refused", "refused", "{:.0%}".format, is_number=True),
        Column("clips", "clips", is_number=True),
    )
    return Table(columns=columns, rows=rows, notes=(NOTE,))
