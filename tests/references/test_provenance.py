"""`scoring/PROVENANCE.md` lists the SHA-256 of each frozen file."""

import hashlib
import re

from places import ROOT

SCORING = ROOT / "scoring"


def test_the_listed_hashes_are_those_of_the_files():
    text = (SCORING / "PROVENANCE.md").read_text()
    listed = {
        name: digest
        for digest, name in re.findall(r"^([0-9a-f]{64})  (.+)$", text, re.MULTILINE)
    }
    changing = set(re.findall(r"^- `(.+)`$", text, re.MULTILINE))
    files = {
        file.relative_to(SCORING).as_posix(): file
        for file in SCORING.rglob("*")
        if file.is_file() and file.suffix != ".md"
    }
    assert listed == {
        name: hashlib.sha256(file.read_bytes()).hexdigest()
        for name, file in files.items()
        if name not in changing
    }
