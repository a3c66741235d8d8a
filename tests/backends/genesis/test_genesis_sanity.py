"""Options of a Genesis scene, as the sanity check reads them from a file."""

import pytest

pytest.importorskip("genesis", reason="extra 'genesis' is not installed")

import genesis as gs

from gauge_envs.tools.sanity import configuration


def saved(folder, **rigid):
    """Save the options of a scene as a user does, and return the file."""
    scene = gs.Scene(
        show_viewer=False,
        sim_options=gs.options.SimOptions(
            dt=0.004, substeps=2, gravity=(0.0, 0.0, -3.7)
        ),
        rigid_options=gs.options.RigidOptions(**rigid),
    )
    path = folder / "options.json"
    path.write_text(scene.options.model_dump_json())
    return path


@pytest.fixture
def engine():
    from gauge_envs.backends.genesis.engine import claim, release

    claim(gs, 32)
    yield
    release(gs)


def test_saved_options_are_those_of_the_scene(engine, tmp_path):
    path = saved(tmp_path, iterations=7, constraint_timeconst=0.03)
    read = configuration(path)
    assert (read.backend, read.language) == ("genesis", "genesis")
    assert read.gravity_m_per_s2 == (0.0, 0.0, -3.7)
    expected = {
        "timestep_s": 0.002,
        "precision": 32,
        "iterations": 7,
        "sustained_timeconst_s": 0.03,
        "impact_steps": None,
    }
    assert {name: read.settings[name] for name in expected} == expected
