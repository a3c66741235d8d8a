"""Documentation: links resolve, code and commands are real, every public name is described, the README stays short."""

from __future__ import annotations

import importlib
import inspect
import re
import shlex
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from places import ROOT

from gauge_envs.cli.app import app

DOCS = ROOT / "docs"
README = ROOT / "README.md"
PAGES = [README, ROOT / "scoring" / "README.md", ROOT / "assets" / "README.md", *sorted(DOCS.rglob("*.md"))]
PAGES = [page for page in PAGES if "_build" not in page.parts]

RUN_ELSEWHERE = {"adding_an_engine.md", "assets.md", "control.md", "ecosystem.md"}
"""Pages whose code other tests run, as it needs an example package or takes long."""
COMPILED_ONLY = {"sanity.md", "sanity_newton.md", "sanity_physx.md"}
"""Pages whose code needs a user's own environment, or an engine that may be absent."""

README_WORDS = 900


def name_of(page: Path) -> str:
    return str(page.relative_to(ROOT))


def fenced(page: Path, language: str) -> list[str]:
    """Code blocks of a page in a language."""
    return re.findall(rf"^```{language}\n(.*?)^```$", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)


def prose(page: Path) -> str:
    """Text of a page without its code blocks and code spans."""
    text = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    return re.sub(r"`[^`\n]*`", "", text)


# --- the README ------------------------------------------------------------------------------------------------------


def test_the_readme_is_short() -> None:
    assert len(README.read_text(encoding="utf-8").split()) <= README_WORDS


# --- links -----------------------------------------------------------------------------------------------------------


def anchors(page: Path) -> set[str]:
    """Anchors of the headings of a page, as GitHub and MyST make them."""
    text = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    titles = re.findall(r"^#+ (.*)$", text, flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def links(page: Path) -> list[str]:
    """Targets of the links and pictures of a page that lead to files of the repository."""
    targets = re.findall(r"\]\(([^)\s]+)\)", prose(page))
    return [target for target in targets if "://" not in target]


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_to_files_and_headings(page: Path) -> None:
    broken = []
    for link in links(page):
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        if not target.is_file() or (anchor and anchor not in anchors(target)):
            broken.append(link)
    assert broken == []


def test_every_page_is_in_the_table_of_contents() -> None:
    listed = {"index"}
    for page in (DOCS / "index.md", DOCS / "api.md"):
        for tree in re.findall(r"^```\{toctree\}\n(.*?)^```$", page.read_text(), flags=re.MULTILINE | re.DOTALL):
            listed |= {line for line in tree.splitlines() if line and not line.startswith(":")}
    assert {str(page.relative_to(DOCS).with_suffix("")) for page in PAGES if DOCS in page.parents} == listed


# --- code ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "page", [p for p in PAGES if fenced(p, "python") and p.name not in RUN_ELSEWHERE | COMPILED_ONLY], ids=name_of
)
def test_python_blocks_run_and_print_what_they_state(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for block in fenced(page, "toml"):
        if match := re.match(r"# (tasks/\w+\.toml)\n", block):
            (tmp_path / "tasks").mkdir(exist_ok=True)
            (tmp_path / match[1]).write_text(block, encoding="utf-8")
    code = "\n".join(fenced(page, "python"))
    if "examples/" in code:
        assert "in a clone of the" in page.read_text(encoding="utf-8")
        (tmp_path / "examples").symlink_to(ROOT / "examples", target_is_directory=True)
    exec(compile(code, page.name, "exec"), {"__name__": "guide"})
    stated = re.findall(r"^ *print\(.*\)  # (.*)$", code, flags=re.MULTILINE)
    assert stated
    assert capsys.readouterr().out.splitlines() == stated


@pytest.mark.parametrize("page", [p for p in PAGES if p.name in COMPILED_ONLY], ids=name_of)
def test_other_python_blocks_compile_and_import(page: Path) -> None:
    for block in fenced(page, "python"):
        compile(block, page.name, "exec")
        for module, names in re.findall(r"^from (gauge_envs[\w.]*) import ([\w, ]+)$", block, flags=re.MULTILINE):
            imported = importlib.import_module(module)
            assert [name for name in names.split(", ") if not hasattr(imported, name)] == []


def test_the_tutorial_quotes_its_task_file() -> None:
    (quoted,) = fenced(DOCS / "tutorial.md", "toml")
    file = (ROOT / "tasks" / "bouncing_ball.toml").read_text(encoding="utf-8")
    tables = quoted.strip().split("\n\n")
    assert len(tables) > 5
    assert [table for table in tables if table not in file] == []


# --- commands --------------------------------------------------------------------------------------------------------


def commands(page: Path) -> list[list[str]]:
    """Commands `gauge ...` in the shell blocks of a page, without comments."""
    lines = [line for block in fenced(page, "sh") for line in block.splitlines() if line.startswith("gauge ")]
    return [shlex.split(line, comments=True)[1:] for line in lines]


def leaves(command: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Commands of the command line by their words, without groups."""
    if not hasattr(command, "commands"):
        yield path, command
        return
    for name in command.list_commands(None):
        yield from leaves(command.get_command(None, name), (*path, name))


LEAVES = dict(leaves(typer.main.get_command(app)))


@pytest.mark.parametrize("page", [p for p in PAGES if commands(p)], ids=name_of)
def test_commands_have_the_options_that_are_shown(page: Path) -> None:
    for words in commands(page):
        # Either a command of a group, or one whose name has two words.
        candidates = (tuple(words[:2]), (" ".join(words[:2]),), tuple(words[:1]))
        path = next(path for path in candidates if path in LEAVES)
        arguments = words[len(" ".join(path).split()) :]
        # Raises where an option is unknown, misses its value, or an argument is too many or missing.
        LEAVES[path].make_context(path[-1], arguments)


def options(command: Any) -> set[str]:
    """Options of a command; `--help` is common to all."""
    names = {name for one in command.params for name in (*one.opts, *one.secondary_opts) if name.startswith("--")}
    return names - {"--help"}


@pytest.mark.parametrize("path", LEAVES, ids=" ".join)
def test_the_page_of_commands_lists_every_command_and_option(path: tuple[str, ...]) -> None:
    text = (DOCS / "commands.md").read_text(encoding="utf-8")
    section = re.search(rf"^## gauge {' '.join(path)}$(.*?)(?=^## |\Z)", text, flags=re.MULTILINE | re.DOTALL)
    assert section is not None
    shown = set(re.findall(r"`(--[\w-]+)", "\n".join(re.findall(r"^\| .* \|$", section[1], flags=re.MULTILINE))))
    assert shown == options(LEAVES[path])


def test_no_command_is_described_that_does_not_exist() -> None:
    titles = re.findall(r"^## gauge (.*)$", (DOCS / "commands.md").read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert set(titles) == {" ".join(path) for path in LEAVES}


# --- public names ----------------------------------------------------------------------------------------------------


def documented_modules() -> dict[str, set[str]]:
    """Modules on the pages of the API reference, each with the names that are left out there."""
    modules = {}
    for page in sorted((DOCS / "api").glob("*.md")):
        for name, body in re.findall(
            r"^\.\. automodule:: (\S+)\n((?:   :.*\n)*)", page.read_text(), flags=re.MULTILINE
        ):
            left_out = re.search(r":exclude-members: (.*)", body)
            modules[name] = set(left_out[1].split(", ")) if left_out else set()
    return modules


def documented_names() -> Iterator[tuple[str, str, Any]]:
    """Module, name and value of every public name on the pages of the API reference."""
    for module, left_out in documented_modules().items():
        imported = importlib.import_module(module)
        for name in getattr(imported, "__all__", ()):
            if name not in left_out:
                yield module, name, getattr(imported, name)


PUBLIC = ("gauge_envs", "gauge_envs.scene", "gauge_envs.backends", "gauge_envs.errors")


@pytest.mark.parametrize("module", PUBLIC)
def test_every_public_module_is_on_the_pages(module: str) -> None:
    assert module in documented_modules()


def is_described(value: Any) -> bool:
    """Whether a docstring is due: of classes and functions, not of type aliases and constants."""
    return inspect.isclass(value) or inspect.isfunction(value)


def test_every_public_class_and_function_has_a_docstring() -> None:
    names = list(documented_names())
    assert len(names) > 80
    bare = [f"{module}.{name}" for module, name, value in names if is_described(value) and not value.__doc__]
    assert bare == []


def test_no_public_name_is_on_the_pages_twice() -> None:
    objects = [(id(value), name) for _, name, value in documented_names() if inspect.isclass(value)]
    assert [name for (_, name), count in Counter(objects).items() if count > 1] == []


@pytest.mark.parametrize("engine", ["mujoco", "drake", "genesis", "newton", "physx", "pybullet", "rapier"])
def test_the_page_of_an_engine_lists_its_presets(engine: str) -> None:
    presets = importlib.import_module(f"gauge_envs.backends.{engine}.settings").PRESETS
    page = (DOCS / "engines" / f"{engine}.md").read_text(encoding="utf-8")
    table = page.partition("\n## Presets\n")[2].partition("\n## ")[0]
    assert set(re.findall(r"^\| `(\w+)` \|", table, flags=re.MULTILINE)) == set(presets)


def test_the_glossary_defines_each_term_once() -> None:
    rows = re.findall(r"^\| (.+?) \| .+ \|$", (DOCS / "glossary.md").read_text(encoding="utf-8"), flags=re.MULTILINE)
    terms = [term for term in rows if term not in ("term", "---")]
    assert len(terms) > 80
    assert [term for term, count in Counter(terms).items() if count > 1] == []


# --- the site --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_site_builds_without_a_warning(tmp_path: Path) -> None:
    for package in ("sphinx", "myst_parser", "furo"):
        pytest.importorskip(package, reason="extra 'docs' is not installed")
    run = subprocess.run(
        [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-b", "html", str(DOCS), str(tmp_path)],
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stderr
    assert (tmp_path / "index.html").is_file()
