"""Finds the numbers that a page states, and where each comes from."""

import re
from functools import cache

from places import ROOT

UNITS = r"""
    % ° degrees? deg rad rad/s rad/s\^2 Hz kHz
    s ms us µs microseconds? seconds? minutes? hours?
    m mm um km cm mm\^2 px m/s mm/s cm/s m/s\^2 m/s² m/J
    g kg kg/m\^2 g/m\^2 N kN J Pa kPa MPa kB MB GB
    words times x sigma cores? checks ids frames trials episodes worlds iterations steps samples nodes prims faults
    videos films clips
""".split()  # noqa: SIM905  one to a line would be long
UNIT = "|".join(sorted(UNITS, key=len, reverse=True))
NUMBER = r"[+-]?(?:\d{1,3}(?: \d{3})+|\d[\d,]*)(?:\.\d+)?(?:e-?\d+)?"
STATED = re.compile(
    rf"(?<![\w./^-])(?:1/)?{NUMBER}(?:(?:,| to| and| or| of| x|,? once| ±| \+-) ?(?:1/)?{NUMBER})*"
    rf"(?:[ -]?(?:{UNIT})(?![\w^]))"
    r"|(?<![\w./^-])[+-]?\d+\.\d+(?![\w.]*\w)"
)
"""A number with a unit, with the numbers that share it; or a decimal fraction, which may be a score or a ratio."""

VERSION = re.compile(
    r"(?:Apache|Python|MuJoCo|Newton|PhysX|SAPIEN(?: \d with PhysX)?|PyBullet|Rapier|Drake|Genesis|genesis-world"
    r"|PyTorch|three\.js|arXiv|version)(?:\]\([^)]*\))? v?\d[\d.]*(?:(?:,| to| and| on Python| or) \d[\d.]*)*"
    rf"(?![\w.]|[ -]?(?:{UNIT})(?!\w))"
)
"""A version after the name of what has it: no measurement."""

STUDY = re.compile(
    r"\]\([^)\s]*\bstudies/(?:README\.md#)?(\w+)(?:/README\.md(?:#[\w-]+)?)?\)"
)


def visible(text):
    """Text of a page without code blocks and generated parts, which other tests compare with what makes them."""
    text = re.sub(r"^ *```.*?^ *```$", "", text, flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"(?<=\n\n)(?: {4}.*\n)+", "", text)
    return re.sub(
        r"<!-- (.+?), written by .+? -->.*?<!-- end of \1 -->",
        "",
        text,
        flags=re.DOTALL,
    )


def blocks(text):
    """Yield each paragraph, list item, row and heading of a page in one line, with the text that introduces it.

    A list or a table is introduced by the paragraph right before it if that ends with a colon, a row by the head of its
    table too.
    """
    introduction, head, current = "", "", ""
    for line in [*text.splitlines(), ""]:
        if current and (re.match(r" *([-*]|\d+\.) |\||#", line) or not line.strip()):
            is_row = current.startswith("|")
            is_item = bool(re.match(r"([-*]|\d+\.) ", current))
            head = (head or current) if is_row else ""
            yield current, f"{introduction} {head}" if is_row or is_item else ""
            if not (is_row or is_item):
                introduction = current if current.endswith(":") else ""
            current = ""
        current = f"{current} {line.strip()}".strip()


def shown(text):
    """What a page shows as written by a script, or as the output of its code and commands."""
    parts = re.findall(
        r"<!-- (.+?), written by .+? -->(.*?)<!-- end of \1 -->", text, flags=re.DOTALL
    )
    outputs = re.findall(r"^```text\n(.*?)^```$", text, flags=re.MULTILINE | re.DOTALL)
    return "\n".join(
        [
            *(part for _, part in parts),
            *outputs,
            *re.findall(r"^ *print\(.*\)  # (.*)$", text, re.MULTILINE),
        ]
    )


@cache
def numbers_of_study(name):
    """Every number in the note and in the tables of a study, or in its findings if it ended, without its sign."""
    folder = ROOT / "studies" / name
    if not folder.is_dir():
        findings = (ROOT / "studies" / "README.md").read_text()
        return values(findings.partition(f"\n## {name}\n")[2].partition("\n## ")[0])
    text = "\n".join(
        file.read_text()
        for file in (folder / "README.md", *sorted(folder.glob("*.csv")))
    )
    return values(text)


def values(text):
    """Numbers of a text, without their signs."""
    plain = re.sub(r"(?<=\d)[, ](?=\d{3}\b)", "", text)
    return tuple(
        float(found) for found in re.findall(r"\d+(?:\.\d+)?(?:e-?\d+)?", plain)
    )


def is_among(number, known):
    """Whether a known number, rounded as this one is, equals it."""
    (value,) = values(number)
    places = len(number.partition(".")[2]) if "e" not in number else None
    return any(
        one == value if places is None else abs(round(one, places) - value) < 1e-9
        for one in known
    )


def unit_of(phrase):
    """Return the unit after the last number of a phrase, or nothing."""
    unit = re.search(r"[^\W\d][^\s]*$|[%°]$", phrase)
    return unit[0] if unit else ""


def sourceless(page, numbers_for=lambda phrase: ()):
    """Return blocks of a page with numbers that no source is known of.

    Args:
        page: Page in Markdown.
        numbers_for: Function that returns the known numbers for a number with its unit.

    Returns:
        For each such block its numbers and its text.
    """
    whole = page.read_text()
    shown_numbers = values(shown(whole))
    found = []
    for block, introduction in blocks(visible(whole)):
        left = VERSION.sub(" · ", re.sub(r"`[^`]*`", "`", block))
        left = re.sub(r"\]\([^)]*\)", "]", left)
        studies = STUDY.findall(block) or STUDY.findall(introduction)
        known = list(shown_numbers)
        for study in studies:
            known += numbers_of_study(study)
        known += [100.0 * number for number in known if number < 1.0]  # 0.45 as 45 %
        bare = []
        for match in STATED.finditer(left):
            phrase = re.sub(r"(?<=\d) (?=\d{3})", "", match[0])
            numbers = re.findall(
                r"\d+(?:[.,]\d+)*(?:e-?\d+)?", phrase.removesuffix(unit_of(phrase))
            )
            everything = [*known, *numbers_for(phrase)]
            if not all(is_among(number, everything) for number in numbers):
                bare.append(match[0])
        if bare:
            found.append(f"{', '.join(bare)}   in: {block[:200]}")
    return found
