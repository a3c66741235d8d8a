"""Finding backends, and what happens when one of somebody else's cannot be loaded."""

import pytest

from gauge_envs.backends import Backend, Support, backend, backend_names, registry
from gauge_envs.backends.registry import backend_class
from gauge_envs.errors import BackendError, MissingExtraError, UnknownNameError
from gauge_envs.experiments.variants import find_variant
from gauge_envs.runs import isolation
from gauge_envs.tools.catalog import listing
from gauge_envs.tools.catalog.listing import list_rows
from gauge_envs.tools.conformance.words import backends_table


class EntryPoint:
    """Stands for an installed package's entry point."""

    value = "somebody:Backend"

    def __init__(self, name, load):
        self.name = name
        self.load = load


class BackendNothing(Backend):
    name = "nothing"
    title = "Nothing at all"
    color = "#123456"

    def versions(self):
        return {"nothing": "1.0"}

    def supports(self, scene):
        return Support(("it does nothing",))

    def build(self, scene, settings=None):
        raise AssertionError("supports declines every scene")


def broken():
    raise OSError("libengine.so: cannot open shared object file")


def missing():
    raise MissingExtraError(
        "backend 'other'",
        "fast",
        ModuleNotFoundError(name="other_engine"),
        package="somebody",
    )


@pytest.fixture
def installed(monkeypatch):
    points = [
        EntryPoint("nothing", lambda: BackendNothing),
        EntryPoint("broken", broken),
        EntryPoint("other", missing),
    ]
    monkeypatch.setattr("gauge_envs.registry.entry_points", lambda group: points)
    backend.cache_clear()
    yield
    backend.cache_clear()


@pytest.mark.usefixtures("installed")
def test_names_are_listed_without_loading_anything():
    assert backend_names() == ("broken", "nothing", "other")


@pytest.mark.usefixtures("installed")
def test_a_backend_that_cannot_be_loaded_says_which_and_why():
    with pytest.raises(
        BackendError, match=r"'broken' \(somebody:Backend\): OSError: libengine\.so"
    ):
        backend("broken")
    with pytest.raises(MissingExtraError, match=r"pip install 'somebody\[fast\]'"):
        backend("other")
    with pytest.raises(UnknownNameError, match="nothing"):
        backend("nothin")


@pytest.mark.usefixtures("installed")
def test_the_others_stay_usable(monkeypatch):
    for module in (isolation, listing):
        monkeypatch.setattr(module, "is_bundled", lambda name: True)
    rows = {row["name"]: row for row in backends_table().rows}
    assert rows["nothing"]["versions"] == {"nothing": "1.0"}
    assert (
        "libengine.so" in rows["broken"]["error"]
        and "somebody[fast]" in rows["other"]["error"]
    )
    lacks = list_rows([find_variant("SlopeSlider-2-wood")])[0]["backends"]
    assert lacks["nothing"] == ["it does nothing"]
    assert "libengine.so" in lacks["broken"][0]


@pytest.mark.usefixtures("installed")
def test_somebody_elses_engine_gives_its_title_and_colour():
    assert backend_class("nothing").title == "Nothing at all"
    assert backend_class("nothing").color == "#123456"
    # Engines that cannot be loaded, or are nowhere, are grey.
    for name in ("broken", "other", "elsewhere"):
        assert backend_class(name).color == ""


def test_engines_of_this_package_have_titles_and_colours_without_being_installed():
    classes = {name: backend_class(name) for name in backend_names()}
    assert {one.title.lower() for one in classes.values()} == set(classes)
    assert (
        len({one.color for one in classes.values()})
        == len({one.marker for one in classes.values()})
        == len(classes)
    )


def test_ctrl_c_in_an_import_is_no_error_of_the_engine():
    def interrupted_import():
        try:
            raise KeyboardInterrupt
        finally:
            raise RuntimeError("cannot release un-acquired lock")

    with pytest.raises(KeyboardInterrupt), registry._as_backend_error("engine"):
        interrupted_import()
