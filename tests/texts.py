"""Change texts of files, and read code blocks of pages."""

import re


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
