"""The skill for agents is short; `tests/docs` runs its commands with those of the guides."""

from places import ROOT

SKILL = ROOT / ".agents" / "skills" / "gauge-envs" / "SKILL.md"
TEXT = SKILL.read_text()

MAX_WORDS = 400


def test_it_is_short_and_says_when_to_use_it():
    assert len(TEXT.split()) <= MAX_WORDS
    start = TEXT.split("---")[1]
    assert f"name: {SKILL.parent.name}\n" in start
    assert "description: " in start
