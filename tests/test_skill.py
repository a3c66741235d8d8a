"""The skill for agents: it is short, its commands exist, and its steps end with a fixed model."""

import re
import shlex

from places import ROOT

from gauge_envs.cli.app import load_command
from gauge_envs.cli.commands import commands
from gauge_envs.cli.schemas import schema_names

SKILL = ROOT / ".agents" / "skills" / "gauge-envs" / "SKILL.md"
TEXT = SKILL.read_text()

MAX_WORDS = 400


def blocks(language):
    """Return the code blocks of a language."""
    return re.findall(rf"```{language}\n(.*?)```", TEXT, re.DOTALL)


def test_it_is_short_and_says_when_to_use_it():
    assert len(TEXT.split()) <= MAX_WORDS
    start = TEXT.split("---")[1]
    assert f"name: {SKILL.parent.name}\n" in start
    assert "description: " in start


def test_its_commands_and_keys_exist():
    names = commands()
    lines = [line for block in blocks("sh") for line in block.splitlines()]
    lines += re.findall(r"`(gauge [^`]*)`", TEXT)
    calls = [shlex.split(line.partition(">")[0]) for line in lines]
    calls = [words[1:] for words in calls if words[0] == "gauge"]
    assert len(calls) >= 10
    for words in calls:
        name = next(name for name in (" ".join(words[:2]), words[0]) if name in names)
        known = {
            option
            for parameter in load_command(name).params
            for option in parameter.opts
        }
        options = {word for word in words if word.startswith("-")}
        assert options <= known, words
        if "--schema" in words:
            assert words[1] in schema_names()
