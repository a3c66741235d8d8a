"""Who is here: engines, instruments, and the doors of packages. The core imports no guest; it asks this module.

An instrument is a package with a file `instrument.toml`, which states what it adds to the suite. Those of this package
are the folders of `gauge_envs/tools`. Those of other packages are entry points of the group `gauge_envs.instruments`,
whose value is the name of a package:

    [project.entry-points."gauge_envs.instruments"]
    drift = "my_package.drift"

The file has these keys, all optional but `position`:

    position = 200                      # place among the commands of `gauge --help`
    extra = "usd"                       # extra of gauge-envs without which no part of the instrument works
    listings = ["drifts"]               # kinds of `gauge list KIND`: function `list_drifts` of `command.py`
    ids = "ids"                         # module with `register`, `names`, `summary` and `document` of Gymnasium ids

    [commands]                          # name and line of help; the function of `command.py` has the name
    drift = "Report how far a resting body drifts."

    [groups]                            # first word of commands of two words
    data = "Real trials and scenes."

    [outputs]                           # type of a line of `--json` of each command, see `gauge_envs/cli/schemas.py`
    drift = { line = "model:Drift", version = 1 }

    [scene_files]                       # module with `read_scene`, `write_scene` and those for experiment files,
                                        # see `gauge_envs/tools/usd/files.py`
    module = "layers"
    suffixes = [".usda"]

    [model_files]                       # module with `read_model` and `load_model`, by engine
    mujoco = "reader"
"""

import ast
import re
import sys
import tomllib
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, fields
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from gauge_envs.errors import RegistryError, needs_extra

ENGINES_GROUP = "gauge_envs.backends"
INSTRUMENTS_GROUP = "gauge_envs.instruments"
BUNDLED = "gauge_envs."
"""First part of the name of a module of this package."""
DECLARATION = "instrument.toml"


@dataclass(frozen=True, kw_only=True)
class SceneFiles:
    """Scene files that an instrument reads and writes.

    Attributes:
        module: Name of the module, whose functions are those of `gauge_envs/tools/usd/files.py`.
        suffixes: Suffixes of the files, as `.usda`.
    """

    module: str
    suffixes: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Output:
    """What a command prints with `--json`.

    Attributes:
        line: Module in the package of the instrument, and name there of the type of a line.
        version: Version of its schema.
    """

    line: str
    version: int


@dataclass(frozen=True, kw_only=True)
class Instrument:
    """What an instrument adds to the suite.

    Attributes:
        name: Name of its folder or entry point.
        package: Name of its package, as `gauge_envs.tools.compare`.
        position: Place among the instruments in the help of `gauge`.
        extra: Extra of this package that it needs, or empty.
        commands: Line of help of each command. A name of two words is listed in the help of the first one.
        groups: Line of help of each first word that is no command.
        listings: Kinds that `gauge list` knows.
        outputs: What its commands print with `--json`, by the words of the command; and other JSON that it writes.
        ids: Name of the module of its Gymnasium ids; or empty. `register()` registers them, `names()` returns them,
            `summary()` returns a line of `gauge list`, and `document(name)` the page of one in `gauge show`.
        scene_files: Scene files that it reads and writes, or None.
        model_files: Name of the module that reads model files of an engine, by the name of the engine.
    """

    name: str
    package: str
    position: int
    extra: str = ""
    commands: Mapping[str, str] = field(default_factory=dict)
    groups: Mapping[str, str] = field(default_factory=dict)
    listings: tuple[str, ...] = ()
    outputs: Mapping[str, Output] = field(default_factory=dict)
    ids: str = ""
    scene_files: SceneFiles | None = None
    model_files: Mapping[str, str] = field(default_factory=dict)

    def function(self, name: str) -> Any:
        """Return a function of the instrument's commands.

        Args:
            name: Words of the name, as `backend check`; the function is `backend_check`, or `list_` for `list`.
        """
        with self.needed(f"gauge {name}"):
            module = import_module(f"{self.package}.command")
        identifier = re.sub(r"\W", "_", name)
        found = getattr(module, f"{identifier}_", None) or getattr(module, identifier)
        return needs_extra(f"gauge {name}", self.extra)(found) if self.extra else found

    def needed(self, feature: str) -> AbstractContextManager[None]:
        """Make a failing import name the extra of the instrument, if it has one."""
        return needs_extra(feature, self.extra) if self.extra else nullcontext()


KEYS = {field.name for field in fields(Instrument)} - {"name", "package"}
"""Keys of a declaration."""


# --- instruments -----------------------------------------------------------------------------------------------------


@cache
def bundled_instruments() -> tuple[Instrument, ...]:
    """Return the instruments of this package."""
    found = []
    for file in Path(__file__).parent.glob(f"tools/*/{DECLARATION}"):
        found.append(
            _declared(file.parent.name, f"gauge_envs.tools.{file.parent.name}", file)
        )
    return tuple(sorted(found, key=_place))


def is_installed(module: str) -> bool:
    """Say whether a top-level module is installed.

    Python also finds a folder without `__init__.py`, as a checkout of an engine beside the user's script; such a folder
    has no origin.
    """
    spec = find_spec(module)
    return spec is not None and spec.origin is not None


@cache
def instruments() -> tuple[Instrument, ...]:
    """Return all instruments: those of this package, then those of others.

    Raises:
        RegistryError: A declaration is wrong.
    """
    foreign = []
    for point in installed_points(INSTRUMENTS_GROUP):
        spec = find_spec(point.value)
        if spec is None or spec.origin is None:
            raise RegistryError(
                f"instrument {point.name!r}: there is no package {point.value!r}"
            )
        foreign.append(
            _declared(point.name, point.value, Path(spec.origin).with_name(DECLARATION))
        )
    return (*bundled_instruments(), *sorted(foreign, key=_place))


def _place(instrument: Instrument) -> tuple[int, str]:
    return instrument.position, instrument.name


def _declared(name: str, package: str, file: Path) -> Instrument:
    """Return the instrument that a file declares."""
    try:
        stated = tomllib.loads(file.read_text(encoding="utf-8"))
        unknown = sorted(set(stated) - KEYS)
        if unknown:
            raise ValueError(
                f"unknown key {unknown[0]!r}; known: {', '.join(sorted(KEYS))}"
            )
        scene_files = stated.get("scene_files")
        return Instrument(
            name=name,
            package=package,
            position=int(stated["position"]),
            extra=stated.get("extra", ""),
            commands=stated.get("commands", {}),
            groups=stated.get("groups", {}),
            listings=tuple(stated.get("listings", ())),
            outputs={
                name: Output(**one) for name, one in stated.get("outputs", {}).items()
            },
            ids=stated.get("ids", ""),
            scene_files=None
            if scene_files is None
            else _scene_files(package, scene_files),
            model_files=stated.get("model_files", {}),
        )
    except (OSError, TypeError, ValueError, KeyError) as error:
        raise RegistryError(f"instrument {name!r}: {file}: {error}") from None


def _scene_files(package: str, stated: Mapping[str, Any]) -> SceneFiles:
    return SceneFiles(
        module=f"{package}.{stated['module']}", suffixes=tuple(stated["suffixes"])
    )


def instruments_by(kind: str) -> dict[str, Instrument]:
    """Return the instrument of each command, listing or output; the first that states a name has it.

    Args:
        kind: `commands`, `listings` or `outputs`.
    """
    found: dict[str, Instrument] = {}
    for instrument in instruments():
        for name in getattr(instrument, kind):
            found.setdefault(name, instrument)
    return found


@cache
def command_lines() -> dict[str, str]:
    """Return the line of help of each command and group, in the order of the help."""
    found: dict[str, str] = {}
    for instrument in instruments():
        for name, line in (*instrument.groups.items(), *instrument.commands.items()):
            found.setdefault(name, line)
    return found


def id_modules() -> tuple[Any, ...]:
    """Return the modules of Gymnasium ids beside the experiments."""
    return tuple(
        _id_module(instrument) for instrument in instruments() if instrument.ids
    )


def register_bundled_ids() -> None:
    """Register the ids of this package's instruments; `import gauge_envs` calls this.

    Another package registers its ids through Gymnasium's entry points, `gymnasium.envs`: a scan here would take as long
    as the rest of the import.
    """
    for instrument in bundled_instruments():
        if instrument.ids:
            _id_module(instrument).register()


def _id_module(instrument: Instrument) -> Any:
    return import_module(f"{instrument.package}.{instrument.ids}")


def scene_suffixes() -> tuple[str, ...]:
    """Return the suffixes of scene files that can be read for any engine."""
    files = [
        instrument.scene_files
        for instrument in instruments()
        if instrument.scene_files is not None
    ]
    return tuple(suffix for one in files for suffix in one.suffixes)


def scene_files(suffix: str) -> Any:
    """Return the module that reads and writes scene files of a suffix.

    Raises:
        RegistryError: No instrument reads such files.
    """
    for instrument in instruments():
        if (
            instrument.scene_files is not None
            and suffix in instrument.scene_files.suffixes
        ):
            with instrument.needed(f"a file {suffix}"):
                return import_module(instrument.scene_files.module)
    raise RegistryError(
        f"no installed instrument reads scene files {suffix!r}; known: {', '.join(scene_suffixes())}"
    )


def model_files(engine: str) -> Any:
    """Return the module that reads model files in the format of an engine.

    Raises:
        RegistryError: No instrument reads them.
    """
    for instrument in instruments():
        if engine in instrument.model_files:
            return import_module(
                f"{instrument.package}.{instrument.model_files[engine]}"
            )
    raise RegistryError(f"no installed instrument reads model files of {engine}")


# --- engines ---------------------------------------------------------------------------------------------------------


def engine_points() -> tuple[EntryPoint, ...]:
    """Return the entry points of engines, without those of this package whose folder is absent."""
    folder = Path(__file__).parent / "backends"
    found = []
    for point in installed_points(ENGINES_GROUP):
        if not point.value.startswith(BUNDLED) or (folder / point.name).is_dir():
            found.append(point)
    return tuple(found)


@cache
def _scanned(
    scan: Callable[..., Any], group: str, path: tuple[str, ...]
) -> tuple[EntryPoint, ...]:
    return tuple(scan(group=group))


def installed_points(group: str) -> tuple[EntryPoint, ...]:
    """Return the entry points of a group. A scan takes 10 to 25 ms, so it is done once for each search path."""
    return _scanned(entry_points, group, tuple(sys.path))


# --- doors -----------------------------------------------------------------------------------------------------------


def door(package: str) -> tuple[Callable[[str], Any], list[str]]:
    """Return `__getattr__` and `__all__` of a package whose public names are imported at their first use (PEP 562).

    The names are stated once, in the imports for type checkers of the package's `__init__.py`:

        if TYPE_CHECKING:
            from gauge_envs.tools.compare.comparison import Comparison as Comparison
        else:
            __getattr__, __all__ = door(__name__)

    Args:
        package: Name of the package, which is being imported.
    """
    origins = _type_checking_imports(Path(str(sys.modules[package].__file__)))

    def lookup(name: str) -> Any:
        if name not in origins:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module, original = origins[name]
        with _needed_by(module):
            value = getattr(import_module(module), original)
        setattr(sys.modules[package], name, value)
        return value

    return lookup, sorted(origins)


def _needed_by(module: str) -> AbstractContextManager[None]:
    """Make a failing import of a module name the extra of its instrument."""
    for instrument in bundled_instruments():
        if instrument.extra and module.startswith(f"{instrument.package}."):
            return instrument.needed(instrument.package)
    return nullcontext()


def _type_checking_imports(file: Path) -> dict[str, tuple[str, str]]:
    """Return module and name there of each name that a file re-exports, `from module import X as X`."""
    found: dict[str, tuple[str, str]] = {}
    for block in ast.parse(file.read_text(encoding="utf-8")).body:
        if (
            isinstance(block, ast.If)
            and isinstance(block.test, ast.Name)
            and block.test.id == "TYPE_CHECKING"
        ):
            for statement in block.body:
                assert (
                    isinstance(statement, ast.ImportFrom)
                    and statement.module is not None
                )
                for alias in statement.names:
                    found[str(alias.asname)] = (statement.module, alias.name)
    return found
