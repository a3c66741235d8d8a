"""Which files are generated, from what, and whether what they were measured from has changed since.

`generated.toml` has a row for each set of generated files, and `inputs.json` the digest of each input of a measured row
when it was measured. A digest is of what matters: the values of a task file and of presets, without comments and
texts for readers, the constants of a module, and the numbers of references.
"""

from __future__ import annotations

import ast
import hashlib
import json
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from gauge_envs.errors import first_names
from gauge_envs.experiments.variants import variants

ROOT = Path(__file__).parents[1]
TABLE = Path(__file__).with_name("generated.toml")
DIGESTS = Path(__file__).with_name("inputs.json")
VERSIONS = "scripts/newest_versions.txt"

PACKAGES = {
    "mujoco": ("mujoco",),
    "newton": ("newton", "mujoco-warp", "warp-lang"),
    "physx": ("sapien",),
    "pybullet": ("pybullet",),
    "rapier": ("rapier3d",),
    "drake": ("drake",),
    "genesis": ("genesis-world", "quadrants"),
}
"""Packages of each engine whose versions decide what it computes."""

SCORES = ("evaluation", "observables", "references")
"""Packages with constants that decide scores."""

BENCHMARK = "benchmark"
"""What stands in the table for the families of the benchmark, without those beyond it."""

SHOWN = 6
"""Names that a message lists."""

TEXTS = {
    "decisions",
    "evaluates",
    "provenance",
    "revision",
    "source",
    "summary",
    "title",
}
"""Keys of task files and sidecars that are texts for readers."""

REFERENCES = ("bands", "models", "single_shot", "statistics", "trials")
"""Folders of `scoring/` with references of experiments."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """A set of generated files.

    Attributes:
        name: Name of the row.
        writes: Patterns of the files; `{engine}` and `{family}` stand for the engine and the family that they are of.
        cost: Time that it takes to make them anew, and what that needs.
        builder: Module that writes them, of `scripts` if it has no dots; empty for a row with a command.
        command: What writes them in place of a builder, in words.
        measured: Whether their inputs tell that they are current; else their contents do, which are quick to compute.
        tasks: Families of experiments that they run, `benchmark` for those of the benchmark, `*` for all.
        references: Families with references that they use, `*` for all.
        engines: Engines that they run, `*` for all.
        scores: Whether they hold scores.
        packages: Further folders whose constants decide them.
        inputs: Patterns of other files that decide them.
    """

    name: str
    writes: tuple[str, ...]
    cost: str
    builder: str = ""
    command: str = ""
    measured: bool = False
    tasks: tuple[str, ...] = ()
    references: tuple[str, ...] = ()
    engines: tuple[str, ...] = ()
    scores: bool = False
    packages: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()

    def files(
        self, root: Path = ROOT, of: Mapping[str, str] | None = None
    ) -> set[Path]:
        """Return the files that exist, of all engines and families or of one."""
        return {file for one in self.patterns(of) for file in root.glob(one)}

    def patterns(self, of: Mapping[str, str] | None = None) -> list[str]:
        """Return the patterns of the files of all engines and families or of one."""
        wanted = {"engine": "*", "family": "*", **(of or {})}
        return [pattern.format(**wanted) for pattern in self.writes]


@dataclass(frozen=True)
class Input:
    """An input of measured files.

    Attributes:
        name: What it is.
        digest: Hash of its contents.
        of: The `engine` that it belongs to, or the `family` with a star.
    """

    name: str
    digest: str
    of: Mapping[str, str]


def rows() -> dict[str, Row]:
    """Return the rows of the table by name."""
    table = tomllib.loads(TABLE.read_text(encoding="utf-8"))
    return {
        name: Row(
            name=name,
            **{
                key: tuple(value) if isinstance(value, list) else value
                for key, value in values.items()
            },
        )
        for name, values in table.items()
    }


def recorded() -> dict[str, dict[str, str]]:
    """Return the stored digests of all measured rows."""
    return dict(json.loads(DIGESTS.read_text(encoding="utf-8")))


def record(row: Row) -> None:
    """Store the digests of the inputs of a row, whose files were just measured."""
    found = recorded() | {row.name: {one.name: one.digest for one in inputs(row)}}
    text = json.dumps(found, indent=1, sort_keys=True) + "\n"
    DIGESTS.write_text(text, encoding="utf-8", newline="\n")


def changed(row: Row, root: Path = ROOT) -> list[Input]:
    """Return the inputs of a measured row that differ from those of the measurement, are new or are gone."""
    before = recorded().get(row.name, {})
    found = list(inputs(row, root))
    gone = before.keys() - {one.name for one in found}
    return [one for one in found if before.get(one.name) != one.digest] + [
        Input(name, "", {}) for name in sorted(gone)
    ]


def staleness(row: Row, root: Path = ROOT) -> str:
    """Return which files of a measured row are stale, why, and what making them anew takes; empty for none."""
    if not row.measured or not (found := changed(row, root)):
        return ""
    stale = {file for one in found for file in row.files(root, one.of)}
    names = sorted(str(file.relative_to(root)) for file in stale)
    shown, why = first_names(names, 1), several(found)
    how = row.command or f"python -m scripts build {row.name}"
    return f"{shown}: measured before {why} changed. Make anew: {how} ({row.cost})"


def several(found: Sequence[Input]) -> str:
    """Return inputs in words, the first ones of many."""
    return first_names([one.name for one in found], SHOWN)


def inputs(row: Row, root: Path = ROOT) -> Iterator[Input]:
    """Yield all inputs of a row with their digests."""
    for family, file in _tasks(row.tasks, root):
        yield Input(
            str(file.relative_to(root)), task_digest(file), {"family": f"{family}*"}
        )
    for family, _ in _tasks(row.references, root):
        yield Input(
            f"references of {family}",
            references_digest(family, root / "scoring"),
            {"family": f"{family}*"},
        )
    engines = PACKAGES if row.engines == ("*",) else row.engines
    for engine in engines:
        yield from _engine(engine, root)
    if row.engines:
        yield _constants("gauge_envs/backends/shared", root)
        yield _constants("gauge_envs/scene", root)
    if row.scores:
        for name in SCORES:
            yield _constants(f"gauge_envs/{name}", root)
    for folder in row.packages:
        yield _constants(folder, root)
    for pattern in row.inputs:
        for file in sorted(root.glob(pattern)):
            yield Input(str(file.relative_to(root)), _digest(_content(file)), {})


def _engine(engine: str, root: Path) -> Iterator[Input]:
    folder = f"gauge_envs/backends/{engine}"
    of = {"engine": engine}
    presets = root / folder / "presets.toml"
    yield Input(f"{folder}/presets.toml", _digest(_content(presets)), of)
    yield _constants(folder, root, of)
    lines = (root / VERSIONS).read_text(encoding="utf-8").splitlines()
    for package in PACKAGES[engine]:
        (line,) = (one for one in lines if one.startswith(f"{package}=="))
        yield Input(f"the version of {package}", line.partition("==")[2], of)


def _tasks(families: Iterable[str], root: Path) -> Iterator[tuple[str, Path]]:
    chosen = set(families)
    if BENCHMARK in chosen:
        chosen |= {variant.family for variant in variants()}
    for file in sorted((root / "tasks").glob("*.toml")):
        family = _table(file.read_text(encoding="utf-8"))["family"]
        if "*" in chosen or family in chosen:
            yield family, file


def _constants(folder: str, root: Path, of: Mapping[str, str] | None = None) -> Input:
    """Return the constants of all modules of a folder; to move one between modules changes nothing."""
    found = [
        one
        for file in (root / folder).rglob("*.py")
        for one in constants(file.read_text(encoding="utf-8")).items()
    ]
    return Input(f"constants of {folder}", _digest(sorted(found)), of or {})


@cache
def constants(text: str, *, texts: bool = False) -> Mapping[str, str]:
    """Return the numbers of names, fields and defaults in a module; with texts all names in capitals.

    Rows share most modules, so that each text is parsed once.
    """
    found: dict[str, str] = {}

    def keep(name: str, value: ast.expr | None, *, always: bool = False) -> None:
        if value is not None and (always or _has_number(value)):
            found[name] = ast.unparse(value)

    def visit(body: Iterable[ast.stmt], prefix: str) -> None:
        for node in body:
            match node:
                case ast.Assign(targets=[ast.Name(id=name)], value=value):
                    keep(prefix + name, value, always=texts and name.isupper())
                case ast.AnnAssign(target=ast.Name(id=name), value=value):
                    keep(prefix + name, value, always=texts and name.isupper())
                case ast.ClassDef(name=name, body=inner):
                    visit(inner, f"{prefix}{name}.")
                case ast.FunctionDef(name=name, args=arguments):
                    defaults = (*arguments.defaults, *arguments.kw_defaults)
                    for place, value in enumerate(defaults):
                        keep(f"{prefix}{name}({place})", value)

    visit(ast.parse(text).body, "")
    return found


def _has_number(value: ast.expr) -> bool:
    return any(
        isinstance(node, ast.Constant) and isinstance(node.value, int | float)
        for node in ast.walk(value)
    )


def task_digest(file: Path) -> str:
    """Return the digest of the numbers of a task file."""
    return _digest(numbers(_table(file.read_text(encoding="utf-8"))))


def references_digest(family: str, scoring: Path) -> str:
    """Return the digest of the numbers of a family's references."""
    found: dict[str, Any] = {
        f"{folder}/{file.name}": _content(file)
        for folder in REFERENCES
        for file in sorted((scoring / folder).glob(f"{family}-*"))
        if file.suffix in (".csv", ".npz", ".toml")
    }
    laws = _table((scoring / "bands" / "laws.toml").read_text(encoding="utf-8"))
    found["laws"] = [
        numbers(law) for law in laws["law"] if law["variants"].startswith(family)
    ]
    return _digest(found)


@cache
def _table(text: str) -> Mapping[str, Any]:
    """Return the contents of a TOML file, of which rows share most."""
    return tomllib.loads(text)


def numbers(value: Any) -> Any:
    """Return a value without the texts for readers."""
    if isinstance(value, dict):
        return {key: numbers(one) for key, one in value.items() if key not in TEXTS}
    return [numbers(one) for one in value] if isinstance(value, list) else value


def _content(file: Path) -> Any:
    if file.suffix == ".py":
        is_builder = file.parent.name == "scripts"
        return constants(file.read_text(encoding="utf-8"), texts=is_builder)
    if file.suffix == ".toml":
        return numbers(_table(file.read_text(encoding="utf-8")))
    return hashlib.sha256(file.read_bytes()).hexdigest()


def _digest(value: Any) -> str:
    text = json.dumps(value, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
