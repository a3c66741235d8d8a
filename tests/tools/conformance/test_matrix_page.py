"""The tables of the page of conformance are what their data gives."""

from places import ROOT

from gauge_envs.tools.conformance.matrix import read_columns

DATA = ROOT / "scoring" / "conformance.json"


def test_every_engine_has_its_default_and_its_documented_defaults():
    columns = read_columns(DATA)
    engines = {column.backend for column in columns}
    assert engines == {
        "mujoco",
        "newton",
        "physx",
        "pybullet",
        "rapier",
        "drake",
        "genesis",
    }
    names = {(column.backend, column.name) for column in columns if column.findings}
    assert names >= {
        (engine, name) for engine in engines for name in ("default", "out_of_box")
    }
