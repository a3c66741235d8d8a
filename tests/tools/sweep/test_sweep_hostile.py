"""Hostile sweep files and options end in an error for people, and nothing is written."""

import pytest

from gauge_envs.errors import ParameterError
from gauge_envs.tools.sweep.folder import earlier_episodes
from gauge_envs.tools.sweep.plan import plan_sweep
from gauge_envs.tools.sweep.spec import sweep_spec

NAME = "SlopeSlider-2-wood"


# --- files of a folder ---


def dangling(file):
    file.symlink_to("nowhere")


def loop(file):
    file.symlink_to(file)


def subfolder(file):
    file.mkdir()


@pytest.mark.parametrize("make", [dangling, loop, subfolder])
def test_what_is_no_file_takes_no_part(make, tmp_path):
    make(tmp_path / "b.json")
    assert earlier_episodes(tmp_path) == {}


# --- sweep files and options ---


def test_endless_combinations_are_refused():
    settings = {f"a{number}": [1, 2] for number in range(15_000)}
    with pytest.raises(
        ParameterError,
        match="more than 1,000,000,000,000,000 episodes, the limit is 1,000,000",
    ):
        plan_sweep(sweep_spec({"variants": [NAME], "settings": settings}))


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("seed = 100000000000000000000", [], "seed: "),
        (
            "[settings]\nmujoco = [1]",
            [],
            "settings.mujoco: the name of an engine; a table of settings is expected",
        ),
        ("", ["--shard", "1" * 5000 + "/2"], "expected NUMBER/COUNT, as 0/16"),
    ],
)
def test_hostile_requests_have_exit_code_2(gauge, text, options, message, tmp_path):
    file = tmp_path / "sweep.toml"
    file.write_text(f'variants = ["{NAME}"]\n{text}\n')
    result = gauge("sweep", file, "--dry-run", "--out", tmp_path / "out", *options)
    assert result.exit_code == 2 and message in " ".join(result.stderr.split())
