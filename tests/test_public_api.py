"""The public names of the package: each resolves, and the import loads no engine."""

from __future__ import annotations

from difflib import unified_diff

import pytest
from programs import printed

import gauge_envs
from gauge_envs.errors import SOURCE, install_command
from scripts import build_surface


@pytest.mark.parametrize("name", gauge_envs.__all__)
def test_every_public_name_resolves_and_is_listed(name):
    assert getattr(gauge_envs, name) is not None
    assert name in dir(gauge_envs)


def test_the_public_names_are_those_of_the_stored_list():
    # After a decision to change a public name: make build NAME=surface, and docs/stability.md for a rename.
    ((file, current),) = build_surface.contents().items()
    stored = file.read_text().splitlines()
    changes = "\n".join(unified_diff(stored, current.splitlines(), n=0, lineterm=""))
    assert not changes, changes


HEAVY = """
cv2 dm_env gauge_envs.envs.dm_env gauge_envs.envs.vector huggingface_hub matplotlib moviepy mujoco newton pandas pxr
pydantic scipy stable_baselines3 torch warp
"""


def test_the_import_loads_no_engine_and_nothing_heavy():
    code = f"import sys, gauge_envs; print(sys.modules.keys() & {set(HEAVY.split())})"
    assert printed("-c", code).strip() == "set()"


def test_the_first_environment_imports_no_scipy_and_its_score_no_tables_or_plots():
    code = """
import sys
import gymnasium
import gauge_envs

def loaded(*heavy):
    return sorted(one for one in heavy if one in sys.modules)

for name in ("Turntable-1-wood", "Turntable-Limit-wood"):
    gymnasium.make(f"GAUGE/{name}").reset(seed=0)
env = gymnasium.make("GAUGE/SlopeSlider-2-wood")
env.reset(seed=0)
env.step(0)
print(loaded("scipy", "pandas", "matplotlib", "rich", "trimesh", "typer", "gauge_envs.scoring.score"))
while not env.step(0)[3]:
    pass
print(loaded("pandas", "matplotlib", "rich", "scipy.stats", "trimesh", "typer"))
"""
    assert printed("-c", code).splitlines() == ["[]", "[]"]


@pytest.mark.parametrize(
    ("origin", "command"),
    [
        (
            '{"url": "file:///", "dir_info": {"editable": true}}',
            "pip install -e '/[x]'",
        ),
        ('{"url": "file:///", "dir_info": {}}', "pip install '/[x]'"),
        ('{"url": "file:///no/such.whl"}', f"pip install '{SOURCE}[x]'"),
        ('{"url": "https://example.org/a.whl"}', f"pip install '{SOURCE}[x]'"),
        (None, f"pip install '{SOURCE}[x]'"),
        ("{", f"pip install '{SOURCE}[x]'"),
    ],
)
def test_an_extra_is_installed_from_where_the_package_is_from(
    origin, command, monkeypatch
):
    class Distribution:
        def read_text(self, name):
            return origin

    monkeypatch.setattr("gauge_envs.errors.distribution", lambda name: Distribution())
    assert install_command("gauge-envs", "x") == command
