"""Documentation: links resolve, code and commands run, and every public name has a docstring."""

import ast
import csv
import importlib
import inspect
import json
import re
import shlex
import tomllib
from importlib.util import find_spec
from pathlib import Path

import pytest
from places import ROOT
from programs import printed
from scipy.stats import t
from texts import command_of, fenced, parse, without_blocks
from typer.testing import CliRunner

from gauge_envs.cli import commands as command_table
from gauge_envs.cli.app import app

DOCS = ROOT / "docs"
README = ROOT / "README.md"
PAGES = [
    README,
    ROOT / "scoring" / "README.md",
    ROOT / "assets" / "README.md",
    *sorted(DOCS.rglob("*.md")),
]
# What a build of the site leaves.
PAGES = [
    page
    for page in PAGES
    if "_build" not in page.parts and DOCS / "studies" not in page.parents
]
PAGES += sorted((ROOT / "studies").rglob("README.md"))
SKILL = ROOT / ".agents" / "skills" / "gauge-envs" / "SKILL.md"

RUN_ELSEWHERE = {
    "adding_a_check.md",
    "adding_an_engine.md",
    "ecosystem.md",
}
"""Pages whose code other tests run, because it needs an example package or takes long."""
COMPILED_ONLY = {"sanity.md", "sweeps.md"}
"""Pages whose code needs a user's own environment or results, or an engine that may be absent."""


def name_of(page):
    return str(page.relative_to(ROOT))


def prose(page):
    """Text of a page without its code blocks and code spans."""
    return re.sub(r"`[^`\n]*`", "", without_blocks(page))


# --- scripts ---------------------------------------------------------------------------------------------------------


SCRIPTS = [
    file
    for folder in ("benchmarks", "scripts", "studies")
    for file in sorted((ROOT / folder).rglob("*.py"))
]


@pytest.mark.parametrize("script", SCRIPTS, ids=name_of)
def test_scripts_import_names_that_exist(script):
    """Tests do not run scripts that take minutes, so this test finds renamed functions in them."""
    for node in ast.walk(ast.parse(script.read_text())):
        if (
            isinstance(node, ast.ImportFrom)
            and (node.module or "").partition(".")[0] == "gauge_envs"
        ):
            imported = importlib.import_module(node.module or "")
            absent = [
                alias.name for alias in node.names if not hasattr(imported, alias.name)
            ]
            assert [
                name for name in absent if find_spec(f"{node.module}.{name}") is None
            ] == []


# --- links -----------------------------------------------------------------------------------------------------------


def anchors(page):
    """Anchors of the headings of a page, as in GitHub and MyST."""
    titles = re.findall(r"^#+ (.*)$", without_blocks(page), flags=re.MULTILINE)
    return {
        re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles
    }


def links(page):
    """Targets of the links and pictures of a page that lead to files of the repository."""
    targets = re.findall(r"\]\(([^)\s]+)\)", prose(page))
    return [target for target in targets if "://" not in target]


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CHANGELOG.md"], ids=name_of)
def test_links_lead_to_files_and_headings(page):
    broken = []
    for link in links(page):
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        if not target.is_file() or (anchor and anchor not in anchors(target)):
            broken.append(link)
    assert broken == []


def test_every_page_is_in_the_table_of_contents():
    listed = {"index"}
    for page in (
        DOCS / "index.md",
        DOCS / "api.md",
        DOCS / "environments" / "index.md",
    ):
        for tree in fenced(page, r"\{toctree\}"):
            names = [
                line
                for line in tree.splitlines()
                if line and not line.startswith((":", "studies/"))
            ]
            listed |= {str((page.parent / name).relative_to(DOCS)) for name in names}
    assert {
        str(page.relative_to(DOCS).with_suffix(""))
        for page in PAGES
        if DOCS in page.parents
    } == listed


# --- code ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "page",
    [
        p
        for p in PAGES
        if fenced(p, "python") and p.name not in RUN_ELSEWHERE | COMPILED_ONLY
    ],
    ids=name_of,
)
def test_python_blocks_run_and_print_their_comments(
    page, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    for block in fenced(page, "toml"):
        if match := re.match(r"# (tasks/\w+\.toml)\n", block):
            (tmp_path / "tasks").mkdir(exist_ok=True)
            (tmp_path / match[1]).write_text(block)
    code = "\n".join(fenced(page, "python"))
    if "examples/" in code:
        assert "in a clone of the" in page.read_text()
        (tmp_path / "examples").symlink_to(ROOT / "examples", target_is_directory=True)
    exec(compile(code, page.name, "exec"), {"__name__": "guide"})
    expected = re.findall(r"^ *print\(.*\)  # (.*)$", code, flags=re.MULTILINE)
    assert expected
    assert capsys.readouterr().out.splitlines() == expected
    check_scores_of_written_files(page)


def check_scores_of_written_files(page):
    """Run `gauge score` on the files of a page, which shows their first lines and then the output."""
    text = page.read_text()
    for name, rest in re.findall(r"^gauge score (\S+)(.*)$", text, flags=re.MULTILINE):
        if not Path(name).is_file():
            continue
        shown = re.findall(r"^```text\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
        head, output = shown[-2:]
        assert Path(name).read_text().startswith(head)
        run = CliRunner().invoke(app, ["score", name, *shlex.split(rest)])
        assert run.exit_code == 0, run.output
        assert output in run.stdout


# --- commands --------------------------------------------------------------------------------------------------------


def commands(page):
    """Commands `gauge ...` in the shell blocks of a page, without comments and files of output."""
    lines = "".join(fenced(page, "sh")).splitlines()
    lines = [line.partition(" > ")[0] for line in lines if line.startswith("gauge ")]
    return [shlex.split(line, comments=True)[1:] for line in lines]


def mentioned(page):
    """Commands with arguments in the text and the tables of a page."""
    texts = re.findall(r"`(gauge [a-z][^`\n]*)`", without_blocks(page))
    return [shlex.split(text)[1:] for text in texts]


@pytest.mark.parametrize(
    "page", [p for p in (*PAGES, SKILL) if commands(p)], ids=name_of
)
def test_commands_have_the_options_that_are_shown(page):
    for words in commands(page):
        parse(words)


# A page that needs a file of the reader: `check_scores_of_written_files` and the tests of these commands make one.
NEEDS_OWN_FILES = {
    "getting_started.md",
    "replay.md",
    "what_changed.md",
    "world_models.md",
}
SCREENS = [
    (page, command, screen)
    for page in PAGES
    if page.name not in NEEDS_OWN_FILES
    for command, screen in re.findall(
        r"^gauge (.*)\n```\n\n```text\n((?:.*\n)*?)```$", page.read_text(), re.MULTILINE
    )
]


SLOW = ("replay", "sanity examples")
"""Starts of commands that take seconds."""


def tokens(text):
    """Numbers, words and signs of a text, without the speed of a fix, which depends on the machine."""
    text = re.sub(r"; (?:as fast|\S+ % (?:faster|slower))$", "", text, flags=re.M)
    return re.findall(r"[-+]?\d+(?:\.\d+)?(?:e[-+]\d+)?|[^\W\d]+|[^\w\s]", text)


def is_alike(shown, word):
    """Whether a word is the one that is shown, or a number that differs by at most 5 %."""
    try:
        return float(word) == pytest.approx(float(shown), rel=0.05)
    except ValueError:
        return word == shown


@pytest.mark.parametrize(
    ("page", "command", "screen"),
    [
        pytest.param(
            page,
            command,
            screen,
            id=command,
            marks=[pytest.mark.slow] if command.startswith(SLOW) else [],
        )
        for page, command, screen in SCREENS
    ],
)
def test_commands_print_the_screens_that_are_shown(
    page, command, screen, tmp_path, monkeypatch
):
    """A line `...` stands for any lines; cells do not wrap."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")
    (tmp_path / "examples").symlink_to(ROOT / "examples", target_is_directory=True)
    rest = tokens(CliRunner().invoke(app, shlex.split(command)).stdout)
    for part in screen.split("...\n"):
        shown = tokens(part)
        places = range(len(rest) - len(shown) + 1)
        place = next((i for i in places if all(map(is_alike, shown, rest[i:]))), None)
        assert place is not None, (part, rest)
        rest = rest[place + len(shown) :]


NOTEBOOKS = sorted((ROOT / "examples" / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize(
    "page", [p for p in (*PAGES, SKILL, *NOTEBOOKS) if mentioned(p)], ids=name_of
)
def test_sentences_name_commands_and_options_that_exist(page):
    unknown = []
    for words in mentioned(page):
        command, arguments = command_of(words)
        known = {
            option
            for parameter in command.params
            for option in (*parameter.opts, *parameter.secondary_opts)
        } | {"--help", "--json"}
        unknown += [
            (*words, word)
            for word in arguments
            if word.startswith("--") and word.partition("=")[0] not in known
        ]
    assert unknown == []


def test_the_page_of_commands_lists_every_command_with_an_example():
    page = DOCS / "commands.md"
    rows = re.findall(
        r"^\| `([a-z -]+)` \| .* \| `gauge (.*)` \|$",
        page.read_text(),
        flags=re.MULTILINE,
    )
    assert [name for name, _ in rows] == list(command_table.commands())
    for name, example in rows:
        assert example.startswith(name)
        parse(shlex.split(example))


# --- public names ----------------------------------------------------------------------------------------------------


def documented_modules():
    """Modules on the pages of the API reference, each with its omitted names."""
    modules = {}
    for page in sorted((DOCS / "api").glob("*.md")):
        for name, body in re.findall(
            r"^\.\. automodule:: (\S+)\n((?:   :.*\n)*)",
            page.read_text(),
            flags=re.MULTILINE,
        ):
            left_out = re.search(r":exclude-members: (.*)", body)
            modules[name] = set(left_out[1].split(", ")) if left_out else set()
    return modules


def documented_names():
    """Module, name and value of every public name on the pages of the API reference."""
    for module, left_out in documented_modules().items():
        imported = importlib.import_module(module)
        for name in getattr(imported, "__all__", ()):
            if name not in left_out:
                yield module, name, getattr(imported, name)


def is_described(value):
    """Whether a value needs a docstring: classes and functions do, type aliases and constants do not."""
    return inspect.isclass(value) or inspect.isfunction(value)


def test_every_public_class_and_function_has_a_docstring():
    names = list(documented_names())
    assert len(names) > 80
    bare = [
        f"{module}.{name}"
        for module, name, value in names
        if is_described(value) and not value.__doc__
    ]
    assert bare == []


# --- the site --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_site_builds_without_a_warning(tmp_path):
    for package in ("sphinx", "myst_parser", "furo"):
        pytest.importorskip(package, reason="extra 'docs' is not installed")
    printed("-m", "sphinx", "-q", "-W", "--keep-going", "-b", "html", DOCS, tmp_path)
    assert (tmp_path / "index.html").is_file()


def test_the_contacts_of_engines_are_those_of_their_tables():
    """The column `glancing` is the check `oblique-slip`, and the others are those of the study."""
    text = (ROOT / "docs" / "engines" / "comparison.md").read_text(encoding="utf-8")
    shown = {}
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        # Genesis has another machine, and not all columns.
        if len(cells) == 11 and all(cells) and cells[0] not in ("engine", "---"):
            shown[cells[0]] = [float(cell) for cell in cells[1:]]
    stored = json.loads((ROOT / "scoring" / "conformance.json").read_text())
    glancing = {
        (column["backend"], column["name"]): column["results"]["oblique-slip"]
        for column in stored["columns"]
    }
    with (ROOT / "studies" / "contacts" / "engines.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == len(shown)
    for row in rows:
        key = row["engine"], row["preset"]
        name = key[0] if key[1] == "default" else f"{key[0]}, `{key[1]}`"
        names = ["step_ms", "slide", "steep", "middle", "grazing"]
        values = [float(row[column]) for column in names]
        values.append(glancing[key]["measured"])
        later = ["rebound", "slip_rebound", "creep_mm_s", "hop_mm"]
        values += [float(row[column]) for column in later]
        assert shown[name] == pytest.approx(values, rel=0.06, abs=0.006), name


def test_numbers_of_engines_are_those_of_the_named_checks():
    """A number before `(check ...)` is the deviation from the law, in the unit of the check or as a share."""
    columns = json.loads((ROOT / "scoring" / "conformance.json").read_text())["columns"]
    found = 0
    for page in sorted((DOCS / "engines").glob("*.md")):
        results = [c["results"] for c in columns if c["backend"] == page.stem]
        for number, name in re.findall(
            r"(\d[\d.]*) (?:%|mm)[^.%|]*?\(checks? `([\w.-]+)`", page.read_text()
        ):
            rows = [result[name] for result in results]
            deviations = [
                scale * abs(row["measured"] - row["expected"])
                for row in rows
                if row["measured"] is not None
                for scale in (1.0, 100.0 / (row["expected"] or 1.0))
            ]
            assert any(
                float(number) == pytest.approx(each, rel=0.1) for each in deviations
            ), (page.name, number, name)
            found += 1
    assert found > 10


def test_ranges_of_constants_hold_a_new_trial_in_95_percent_of_cases():
    """Mean and standard deviation s of n trials: t s sqrt(1 + 1 / n) on each side, with Student's t."""
    facts = ROOT / "scoring" / "facts"
    slides = tomllib.loads((facts / "slope_slider_30deg_summary.toml").read_text())
    drops = tomllib.loads((facts / "bouncing_ball_summary.toml").read_text())
    measured = {
        f"friction, {name} on wood": (each["trial_count"], each["friction"])
        for name, each in slides.items()
    }
    measured["restitution, rubber ball on wood"] = (
        drops["trial_count"],
        drops["rebound_ratio"],
    )
    rows = re.findall(
        r"^\| (.* on wood) \| ([\d.]+) to ([\d.]+) \| (\d+) \|$",
        (DOCS / "recipes.md").read_text(),
        re.MULTILINE,
    )
    assert [name for name, *_ in rows] == list(measured)
    for name, low, high, shown in rows:
        count, value = measured[name]
        half = t.ppf(0.975, count - 1) * value["std"] * (1.0 + 1.0 / count) ** 0.5
        ends = (value["mean"] - half, value["mean"] + half)
        assert (float(low), float(high)) == pytest.approx(ends, abs=0.0006)
        assert int(shown) == count
