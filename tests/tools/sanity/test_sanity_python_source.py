"""Values that are read from Python source without running it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity.python_source.source import Source
from gauge_envs.tools.sanity.python_source.values import UNKNOWN, Config, External, Instance

MODULES = {
    "__init__": "raise RuntimeError('was run')\nROOT = __file__",
    "numbers/__init__": "from . import low\nfrom .low import STEP as step\nimport torch as t\nfrom far import thing",
    "numbers/low": """
from functools import partial
from ml import config
STEP = 0.001 * (1 + 3)
NAMES = {"a": [1, 2], **{}}
SHORT = step_name = f"step {STEP}"
UNSTATED = open("/etc/passwd").read()
LIST = [2 * one for one in range(3)]

def default():
    return config.create(step=STEP, size=4 * 8192, nested=config.create(on=not False), late=int("7"))

def chosen(kind, *, extra=1):
    if kind == "big":
        return {"small": 1, "big": 2}[kind] + extra
    return -1

def total(values):
    result = 0
    for one in values:
        result = result + one
    return result

def endless(n):
    return endless(n + 1)

class Base:
    LIMIT = 3
    def __init__(self, config, scale=2):
        self._config = config.lock()
        self._scale = scale
    @property
    def double(self):
        return self._scale * self.LIMIT
    @staticmethod
    def twice(value):
        return 2 * value

class Task(Base):
    LIMIT = 5
    def __init__(self, kind="flat", config=default()):
        if kind.startswith("rough"):
            config.size = 1
        if thing_that_is_not_known():
            config.size = 99
        super().__init__(config=config)
        self.model = engine.load("x")
        self.model.opt.timestep = self._config.step
        self.value, other = self.double, self.twice(4)
        self.other = other if other > 0 else None

class Plain:
    first: int
    second: list = field(default_factory=list)
    third: str = field(default="c")

MADE = partial(Task, kind="rough_1")
RECORD = Plain(1, second=[2])
import engine
from dataclasses import field
""",
}


@pytest.fixture
def source(tmp_path: Path) -> Source:
    for name, text in MODULES.items():
        path = (tmp_path / "stack" / name).with_suffix(".py")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    known = {
        "ml.config.create": lambda _, kwargs: Config(kwargs),
        "engine.load": lambda *_: Instance(External("engine.Model"), {"opt": Instance(External("engine.Option"))}),
    }
    return Source(tmp_path / "stack", "stack", known)


def value(source: Source, name: str) -> Any:
    module = source.module("stack.numbers.low")
    assert module is not None
    return source.value(module, name)


def test_values_are_read_and_nothing_is_run(source: Source) -> None:
    assert value(source, "STEP") == 0.004
    assert value(source, "NAMES") == {"a": [1, 2]}
    assert value(source, "SHORT") == value(source, "step_name") == "step 0.004"
    assert value(source, "LIST") == [0, 2, 4]
    assert value(source, "UNSTATED") is UNKNOWN
    assert value(source, "absent") is UNKNOWN
    root = source.module("stack")
    assert root is not None and source.value(root, "ROOT") == str(root.path)


def test_imports_are_followed_inside_the_package_alone(source: Source) -> None:
    module = source.module("stack.numbers")
    assert module is not None
    assert source.value(module, "step") == 0.004
    assert source.value(module, "low") is source.module("stack.numbers.low")
    assert source.value(module, "t") == External("torch")
    assert source.value(module, "thing") == External("far.thing")
    assert source.module("stack.absent") is None
    assert source.module("other.low") is None


def test_functions_are_called(source: Source) -> None:
    assert source.call(value(source, "default"), [], {}) == {
        "step": 0.004,
        "size": 32768,
        "nested": {"on": True},
        "late": 7,
    }
    assert source.call(value(source, "chosen"), ["big"], {"extra": 5}) == 7
    assert source.call(value(source, "chosen"), ["other"], {}) == -1
    assert source.call(value(source, "total"), [[1, 2, 3]], {}) == 6
    assert source.call(value(source, "endless"), [0], {}) is UNKNOWN
    assert source.call(External("os.system"), ["touch x"], {}) is UNKNOWN


def test_classes_with_bases_properties_and_branches(source: Source) -> None:
    flat = source.call(value(source, "Task"), [], {})
    # A branch on what is not known is left out.
    assert flat.attributes["_config"]["size"] == 32768
    assert flat.attributes["model"].attributes["opt"].attributes == {"timestep": 0.004}
    assert (flat.attributes["value"], flat.attributes["other"]) == (10, 8)
    rough = source.call(value(source, "MADE"), [], {})
    assert rough.attributes["_config"]["size"] == 1
    record = value(source, "RECORD")
    assert record.attributes == {"first": 1, "second": [2], "third": "c"}


def test_a_long_computation_ends(tmp_path: Path) -> None:
    (tmp_path / "slow").mkdir()
    loops = "\n".join(f"{'    ' * (n + 1)}for a{n} in range(1000):" for n in range(3))
    (tmp_path / "slow" / "__init__.py").write_text(f"def run():\n{loops}\n{'    ' * 4}x = 1\n")
    source = Source(tmp_path / "slow", "slow")
    module = source.module("slow")
    assert module is not None
    with pytest.raises(TargetError, match="more statements than are evaluated"):
        source.call(source.value(module, "run"), [], {})


def test_a_broken_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "__init__.py").write_text("def (")
    with pytest.raises(TargetError, match=r"__init__.py: cannot be read: .*; reinstall its package"):
        Source(tmp_path / "broken", "broken").module("broken")
