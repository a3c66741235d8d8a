"""The skill for agents: it is short, its commands exist, and whoever follows it ends with a mended model."""

import re
import shlex

from places import ROOT

from gauge_envs.cli.app import load_command
from gauge_envs.cli.commands import commands
from gauge_envs.cli.schemas import schema_names

SKILL = ROOT / ".agents" / "skills" / "gauge-envs" / "SKILL.md"
TEXT = SKILL.read_text()

MOST_WORDS = 400


def blocks(language):
    """Return the code blocks of a language."""
    return re.findall(rf"```{language}\n(.*?)```", TEXT, re.DOTALL)


def test_it_is_short_and_states_when_to_use_it():
    assert len(TEXT.split()) <= MOST_WORDS
    start = TEXT.split("---")[1]
    assert f"name: {SKILL.parent.name}\n" in start
    assert "description: " in start


def test_its_commands_and_keys_exist():
    names = commands()
    lines = [line for block in blocks("sh") for line in block.splitlines()]
    lines += re.findall(r"`(gauge [^`]*)`", TEXT)
    found = [shlex.split(line.partition(">")[0]) for line in lines]
    found = [words[1:] for words in found if words[0] == "gauge"]
    assert len(found) >= 10
    for words in found:
        name = next(name for name in (" ".join(words[:2]), words[0]) if name in names)
        known = {option for one in load_command(name).params for option in one.opts}
        stated = {word for word in words if word.startswith("-")}
        assert stated <= known, words
        if "--schema" in words:
            assert words[1] in schema_names()
