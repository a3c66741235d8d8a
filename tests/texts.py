"""Change texts of files, and read code blocks and commands of pages."""

import re

from gauge_envs.cli.app import load_command
from gauge_envs.cli.commands import help_lines


def changed_text(path, *replacements, to=None, count=1):
    """Replace texts that a file must contain; return the file, or the copy with the result."""
    text = path.read_text()
    for old, new in replacements:
        assert old in text, old
        text = text.replace(old, new, count)
    target = path if to is None else to
    target.write_text(text)
    return target


def fenced(page, language):
    """Return the code blocks of a page in a language."""
    return re.findall(
        rf"^```{language}\n(.*?)^```$",
        page.read_text(),
        flags=re.MULTILINE | re.DOTALL,
    )


def without_blocks(page):
    """Return the text of a page without its code blocks."""
    flags = re.MULTILINE | re.DOTALL
    return re.sub(r"^```.*?^```$", "", page.read_text(), flags=flags)


def command_of(words):
    """Return the command of words, and its arguments."""
    names = (" ".join(words[:2]), words[0])
    name = next(name for name in names if name in help_lines())
    return load_command(name), words[len(name.split()) :]


def parse(words):
    """Raise an error for an unknown option, a missing value, or a wrong number of arguments."""
    command, arguments = command_of(words)
    command.make_context(command.name, arguments)
