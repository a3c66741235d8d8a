"""Shell commands of the guides, each with the environment of its page."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase

BLOCK = re.compile(
    r"^(?P<fence>`{3,})(?:sh|bash|console|shell|\{code-block\} (?:sh|bash|console|shell))$(?P<body>.*?)^(?P=fence)$",
    re.MULTILINE | re.DOTALL,
)
COMMENT = re.compile(r"\s+#\s.*$|^#.*$")
DEFAULT = "default"


@dataclass(frozen=True)
class Command:
    """A command of a page with its environment, or with the reason to skip it."""

    page: str
    text: str
    environment: str
    skip: str | None = None


@dataclass(frozen=True)
class Table:
    """Content of `install_commands.toml`."""

    pages: tuple[str, ...]
    environments: Mapping[str, tuple[str, ...]]
    page_environments: Mapping[str, str]
    page_folders: Mapping[str, str]
    scripts: Mapping[str, str]
    rules: tuple[Mapping[str, str], ...]

    @classmethod
    def read(cls, file):
        content = tomllib.loads(file.read_text())
        return cls(
            pages=tuple(content["pages"]),
            environments={
                name: tuple(extras) for name, extras in content["environments"].items()
            },
            page_environments=content["page_environments"],
            page_folders=content["page_folders"],
            scripts=content["scripts"],
            rules=tuple(content["rules"]),
        )

    def rule(self, page, text):
        """Return the first rule that matches a command."""
        fitting = (
            rule
            for rule in self.rules
            if rule.get("page", page) == page and fnmatchcase(text, rule["command"])
        )
        return next(fitting, None)

    def command(self, page, text):
        """Return the environment of a command; that of its page has priority over that of a rule."""
        rule = self.rule(page, text) or {}
        environment = self.page_environments.get(page, rule.get("environment", DEFAULT))
        return Command(page, text, environment, rule.get("skip"))

    def commands(self, root):
        """Return every command of every page in the order of the pages, then the scripts."""
        # A build of the site creates copies of the notes of studies.
        files = sorted(
            {file for pattern in self.pages for file in root.glob(pattern)}
            - set(root.glob("docs/studies/*"))
        )
        pages = [
            (file.relative_to(root).as_posix(), file.read_text()) for file in files
        ]
        commands = [
            self.command(page, text)
            for page, content in pages
            for text in shell_commands(content)
        ]
        return (
            *commands,
            *(
                Command("scripts", text, environment)
                for text, environment in self.scripts.items()
            ),
        )


def shell_commands(markdown):
    """Commands of the fenced shell blocks of a page, without comments and prompts."""
    for block in BLOCK.finditer(markdown):
        for line in block["body"].replace("\\\n", " ").splitlines():
            text = COMMENT.sub("", line.strip().removeprefix("$ ")).strip()
            if text:
                yield re.sub(r"\s+", " ", text)
