"""`scoring/PROVENANCE.md` has the SHA-256 of each frozen file."""

import hashlib
import re

from places import ROOT

SCORING = ROOT / "scoring"


def test_the_hashes_are_those_of_the_files():
    text = (SCORING / "PROVENANCE.md").read_text()
    stated = {
        name: digest
        for digest, name in re.findall(r"^([0-9a-f]{64})  (.+)$", text, re.MULTILINE)
    }
    changing = set(re.findall(r"^- `(.+)`$", text, re.MULTILINE))
    found = {
        file.relative_to(SCORING).as_posix(): file
        for file in SCORING.rglob("*")
        if file.is_file() and file.suffix != ".md"
    }
    assert stated == {
        name: hashlib.sha256(file.read_bytes()).hexdigest()
        for name, file in found.items()
        if name not in changing
    }
