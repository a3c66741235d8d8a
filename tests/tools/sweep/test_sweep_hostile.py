"""Hostile sweep files, result files and stores end in an error for people, and nothing is written."""

from __future__ import annotations

import os
import sqlite3
import stat
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from sweep_lanes import stored
from typer.testing import CliRunner

from gauge_envs.cli.app import app
from gauge_envs.errors import GaugeError, ParameterError
from gauge_envs.evaluation.score import Score
from gauge_envs.runs.result import Outcome, Result
from gauge_envs.tools.sweep import command
from gauge_envs.tools.sweep.plan import plan_sweep
from gauge_envs.tools.sweep.spec import sweep_spec
from gauge_envs.tools.sweep.store import EarlierCosts, SweepFolder, SweepStore, update_store

NAME = "SlopeSlider-2-wood"
ESCAPE = "\x1b[2J"


def failed(**changes: Any) -> Result:
    values: dict[str, Any] = {
        "id": f"GAUGE/{NAME}",
        "outcome": Outcome.FAILED,
        "parameters": "calibrated",
        "score": Score(grade="trials", unit="mm"),
        "task_sha256": "0",
        "backend": "mujoco",
        "error": "it broke",
        "seed": 0,
    }
    return Result(**values | changes)


@pytest.fixture
def folder(tmp_path: Path) -> SweepFolder:
    """A folder with the result file of an episode that did not run."""
    folder = SweepFolder(tmp_path / "out")
    folder.create()
    folder.write(failed(), "a.json")
    return folder


def gauge(*arguments: Any) -> Any:
    return CliRunner(env={"COLUMNS": "160"}).invoke(app, list(map(str, arguments)))


# --- files of a folder ---


def test_result_files_hold_what_sqlite_does_not(folder: SweepFolder) -> None:
    hostile = {
        "seed": 10**30,
        "settings": {"timestep_s": [1, {"a": 2}], "preset": {"b": 1}},
        "error": "\ud800" + ESCAPE,
        "marker_proxy": "material",
    }
    folder.write(failed(**hostile), "b.json")
    rows = stored(folder.path, "SELECT error, seed, timestep_s, preset FROM results ORDER BY file")
    assert rows == [("it broke", 0, None, None), ("\\ud800" + ESCAPE, float("inf"), '[1, {"a": 2}]', '{"b": 1}')]


def test_names_of_files_are_no_unicode(folder: SweepFolder) -> None:
    file = folder.path / "failed" / os.fsdecode(b"\xff.json")
    file.write_bytes((folder.path / "failed" / "a.json").read_bytes())
    for _ in range(2):
        assert stored(folder.path, "SELECT file FROM results ORDER BY file") == [
            ("failed/\\udcff.json",),
            ("failed/a.json",),
        ]


def dangling(file: Path) -> None:
    file.symlink_to("nowhere")


def loop(file: Path) -> None:
    file.symlink_to(file)


def fifo(file: Path) -> None:
    os.mkfifo(file)


def subfolder(file: Path) -> None:
    file.mkdir()


@pytest.mark.parametrize("make", [dangling, loop, fifo, subfolder])
def test_what_is_no_file_takes_no_part(make: Callable[[Path], None], folder: SweepFolder) -> None:
    make(folder.path / "b.json")
    assert stored(folder.path, "SELECT file FROM results") == [("failed/a.json",)]


# --- stores ---

ENDLESS = "WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n) SELECT {0} FROM n"


def spoil_text(store: Path) -> None:
    with closing(sqlite3.connect(store)) as connection, connection:
        connection.execute("UPDATE results SET file = CAST(x'ff' AS TEXT), outcome = 'diverged'")


def add_trigger(store: Path) -> None:
    with closing(sqlite3.connect(store)) as connection, connection:
        connection.execute(
            f"CREATE TRIGGER t DELETE ON results BEGIN INSERT INTO results(file) {ENDLESS.format('x')}; END"
        )


def make_view(store: Path) -> None:
    with closing(sqlite3.connect(store)) as connection, connection:
        columns = ", ".join(f"x AS {row[1]}" for row in connection.execute("PRAGMA table_info(results)"))
        connection.execute("DROP TABLE results")
        connection.execute(f"CREATE VIEW results AS {ENDLESS.format(columns)}")


def make_folder(store: Path) -> None:
    store.unlink()
    store.mkdir()


def make_fifo(store: Path) -> None:
    store.unlink()
    os.mkfifo(store)


def lock(store: Path) -> None:
    store.unlink()
    store.symlink_to("/proc/self/mem")


@pytest.mark.parametrize("damage", [spoil_text, add_trigger, make_view, make_folder, make_fifo, lock])
def test_a_hostile_store_is_an_error_or_is_made_again(damage: Callable[[Path], None], folder: SweepFolder) -> None:
    update_store(folder.path)
    damage(folder.store_path)
    for used in (asked, synchronised):
        try:
            outcome = used(folder)
        except GaugeError as error:
            outcome = str(error)
        assert outcome is None or "sweep.sqlite" in outcome, outcome
    EarlierCosts(folder)


def asked(folder: SweepFolder) -> str | None:
    """Return what is said about the store; without a word, its rows must be those of the files."""
    notes: list[str] = []
    rows = stored(folder.path, "SELECT outcome FROM results", notes.append)
    assert notes or rows == [("failed",)]
    return " ".join(notes) or None


def synchronised(folder: SweepFolder) -> str | None:
    with SweepStore(folder, lambda text: None) as store:
        store.synchronise()
        store.diverged(())
    return None


def test_costs_of_a_hostile_store_are_unknown(folder: SweepFolder) -> None:
    with SweepStore(folder, lambda text: None) as store:
        store.synchronise()
    with closing(sqlite3.connect(folder.store_path)) as connection, connection:
        connection.execute("UPDATE results SET outcome = 'finished', wall_s = 'long', sim_s = 1, timestep_s = 1e-3")
        connection.execute(
            "INSERT INTO results (file, outcome, wall_s, sim_s, timestep_s) VALUES ('b', 'finished', 1, 9e999, 1)"
        )
    EarlierCosts(folder)


# --- sweep files and options ---


def test_endless_combinations_are_refused() -> None:
    settings = {f"a{number}": [1, 2] for number in range(15_000)}
    with pytest.raises(ParameterError, match="more than 1,000,000,000,000,000 episodes, the limit is 1,000,000"):
        plan_sweep(sweep_spec({"variants": [NAME], "settings": settings}))


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("seed = 100000000000000000000", [], "seed: "),
        ("[settings]\nmujoco = [1]", [], "settings.mujoco: the name of an engine; a table of settings is expected"),
        (
            'backends = ["rapier"]\n[settings]\nmujoco = [1]',
            ["backends=mujoco", "--set", "mujoco.iterations=3"],
            "settings.mujoco of the sweep file is a list",
        ),
        ("", ["--shard", "1" * 5000 + "/2"], "expected NUMBER/COUNT, as 0/16"),
    ],
)
def test_hostile_requests_have_exit_code_2(text: str, options: list[str], message: str, tmp_path: Path) -> None:
    file = tmp_path / "sweep.toml"
    file.write_text(f'variants = ["{NAME}"]\n{text}\n')
    result = gauge("sweep", file, "--dry-run", "--out", tmp_path / "out", *options)
    assert result.exit_code == 2 and message in " ".join(result.stderr.split())


def test_there_are_no_more_lanes_than_tasks() -> None:
    from gauge_envs.tools.sweep.lanes import Limits

    assert len(command._lanes(None, 10**9, Limits(), 3)) == 3


def test_the_slurm_script_takes_the_place_of_no_device(tmp_path: Path) -> None:
    (tmp_path / "sweep.toml").write_text(f'variants = ["{NAME}"]\n')
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    result = gauge("sweep", tmp_path / "sweep.toml", "--slurm", pipe)
    assert result.exit_code == 2 and "it is not a regular file" in result.stderr
    assert stat.S_ISFIFO(pipe.stat().st_mode)
