"""`gauge demo`: its page needs no network, and each command of a card prints the card's number."""

import re
import shlex

import pytest
from places import ROOT

from gauge_envs.errors import MissingExtraError
from gauge_envs.tools.demo import card as card_module


@pytest.fixture(scope="module")
def made():
    return list(card_module.cards())


def numbers(text):
    return [float(number) for number in re.findall(r"-?\d+(?:\.\d+)?", text)]


@pytest.mark.parametrize("index", [0, 1, pytest.param(2, marks=pytest.mark.slow), 3])
def test_the_command_of_a_card_prints_its_number(index, made, gauge, tmp_path, capsys):
    card = made[index]
    words = shlex.split(card.command)
    if words[0] == "gauge":
        where = ["--out", tmp_path] if words[1] == "run" else []
        output = gauge(*words[1:], *where).stdout
    else:
        exec(compile(card.command, card.title, "exec"), {})
        output = capsys.readouterr().out
    digits = len(card.value.partition(".")[2])
    shown = [f"{number:.{digits}f}" for number in numbers(output)]
    assert card.value in shown
    assert f"{card.value} {card.unit}" in card.text


def test_the_numbers_are_those_of_the_real_drops_and_of_the_law(made):
    engine, constants, contacts, policy = (float(card.value) for card in made)
    # The real rebound ratio is 0.74, and the published one 0.58, of a fall of 0.39 m.
    assert 390 * (0.737**2 - 0.577**2) / 4 < engine < 390 * (0.737**2 - 0.577**2)
    assert constants < 0.01 * engine
    assert contacts > 10 * 1.41
    assert 95 < policy < 100
    readme = (ROOT / "README.md").read_text()
    assert f"creeps {contacts:.0f} mm in 1 s.](docs/images/hero.webp)" in readme


def test_the_page_is_one_file_without_network(gauge, tmp_path, made, monkeypatch):
    monkeypatch.setattr("gauge_envs.tools.demo.command.cards", lambda: iter(made))
    file = tmp_path / "page.html"
    run = gauge("demo", "--no-open", "--out", file)
    text = file.read_text()
    assert run.stdout.splitlines()[-1] == str(file)
    assert "http" not in text
    assert text.count("<article>") == 4
    assert "prefers-color-scheme: dark" in text
    for card in made:
        assert f">{card.value}<small> {card.unit}</small>" in text
        # A number is named beside its colour, which not everybody sees.
        assert len(re.findall("<text", "".join(card.shapes))) >= 2


def test_the_page_opens_in_a_browser(gauge, tmp_path, monkeypatch):
    opened = []
    monkeypatch.setattr("gauge_envs.tools.demo.command.cards", lambda: iter(()))
    monkeypatch.setattr("webbrowser.open", opened.append)
    file = tmp_path / "page.html"
    gauge("demo", "--out", file)
    assert opened == [file.as_uri()]


def test_a_card_says_what_is_missing(monkeypatch):
    def without_assets():
        raise MissingExtraError("gauge sanity", "sanity", ImportError("gymnasium"))

    monkeypatch.setattr(card_module, "creep", without_assets)
    card = card_module.contacts_card()
    assert "[sanity]" in card.text
    assert card.value == ""
