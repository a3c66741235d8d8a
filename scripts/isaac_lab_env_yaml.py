r"""Write the `env.yaml` of a task of Isaac Lab with its own classes and its own writer, without Isaac Sim.

Isaac Lab's wheel imports Isaac Sim, which needs a GPU. Its classes of configuration do not use it, so modules of Isaac
Sim are replaced by empty ones. Run it where the wheel and PyTorch are installed:

    pip install --no-deps isaaclab
    pip install torch pyyaml gymnasium
    python scripts/isaac_lab_env_yaml.py \
        isaaclab_tasks.manager_based.locomotion.velocity.config.g1.flat_env_cfg G1FlatEnvCfg env.yaml
"""

from __future__ import annotations

import argparse
import importlib
import sys
import types
from collections.abc import Iterator, Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from typing import Any

PACKAGES = (
    "isaaclab",
    "isaaclab_tasks",
    "isaaclab_assets",
    "isaaclab_rl",
    "isaaclab_contrib",
    "isaaclab_mimic",
)
"""Source packages inside the wheel."""

ABSENT = (
    *(
        "carb",
        "einops",
        "flatdict",
        "h5py",
        "hid",
        "hydra",
        "isaacsim",
        "isaacteleop",
        "nvidia",
        "omegaconf",
        "omni",
    ),
    *(
        "onnx",
        "pink",
        "pinocchio",
        "prettytable",
        "pxr",
        "toml",
        "torchvision",
        "transformers",
        "trimesh",
        "usdrt",
    ),
    "warp",
)
"""Packages that are replaced by empty modules."""


class _AnyKind(type):
    """Class of classes that have every attribute."""

    def __getattr__(cls, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return Anything

    def __or__(cls, other: Any) -> Any:
        return cls

    __ror__ = __or__

    def __getitem__(cls, item: Any) -> Any:
        return cls

    def __iter__(cls) -> Iterator[Any]:
        return iter(())


class Anything(metaclass=_AnyKind):
    """Object that stands for every class, function and value of an absent package."""

    def __init__(self, *arguments: Any, **keywords: Any) -> None:
        pass

    def __call__(self, *arguments: Any, **keywords: Any) -> Any:
        """Return the decorated function for a decorator, and anything for another call."""
        return arguments[0] if arguments and callable(arguments[0]) else Anything()

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return Anything()

    def __getitem__(self, item: Any) -> str:
        return ""

    def __iter__(self) -> Iterator[Any]:
        return iter(())

    def __bool__(self) -> bool:
        return False


class _AbsentModule(types.ModuleType):
    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return Anything


class _Absent(MetaPathFinder, Loader):
    """Finder of absent packages."""

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: Any = None
    ) -> ModuleSpec | None:
        return (
            ModuleSpec(name, self, is_package=True)
            if name.partition(".")[0] in ABSENT
            else None
        )

    def create_module(self, spec: ModuleSpec) -> types.ModuleType:
        module = _AbsentModule(spec.name)
        module.__path__ = []
        return module

    def exec_module(self, module: Any) -> None:
        if module.__name__ == "toml":
            module.load = lambda file: {"package": {"version": "unknown"}}
        if module.__name__ == "carb.settings":
            module.get_settings = lambda: types.SimpleNamespace(
                get=lambda key: "nucleus"
            )


def main() -> None:
    """Write the file that a training run of the task would write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "module",
        help="module of the configuration, such as isaaclab_tasks.direct.cartpole...",
    )
    parser.add_argument("name", help="class of the configuration, such as G1FlatEnvCfg")
    parser.add_argument("file", type=Path)
    given = parser.parse_args()
    wheel = PathFinder.find_spec("isaaclab")
    if wheel is None or not wheel.submodule_search_locations:
        raise SystemExit("isaaclab is not installed: pip install --no-deps isaaclab")
    source = Path(wheel.submodule_search_locations[0]) / "source"
    sys.path[:0] = [str(source / package) for package in PACKAGES]
    sys.meta_path.insert(0, _Absent())
    import carb

    carb.settings = importlib.import_module("carb.settings")
    cfg = getattr(importlib.import_module(given.module), given.name)()
    importlib.import_module("isaaclab.utils.io").dump_yaml(
        str(given.file.resolve()), cfg
    )


if __name__ == "__main__":
    main()
