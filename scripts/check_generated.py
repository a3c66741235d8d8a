"""Check that generated files are current, by the table `scripts/generated.toml`.

python scripts/check_generated.py           runs all quick checks; fails if a file is not current
python scripts/check_generated.py --list    prints which script writes which files
"""

from __future__ import annotations

import argparse
import hashlib
import importlib
import sys
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from generated import ROOT

TABLE = Path(__file__).with_name("generated.toml")


def entries() -> list[dict[str, Any]]:
    """Return the rows of the table."""
    return list(tomllib.loads(TABLE.read_text(encoding="utf-8"))["written"])


def hash_of(files: Sequence[str]) -> str:
    """Return the SHA-256 of the contents of files, one after another."""
    return hashlib.sha256(
        b"".join((ROOT / file).read_bytes() for file in files)
    ).hexdigest()


def faults(entry: Mapping[str, Any]) -> list[str]:
    """Return what is wrong with the files of a row; the check of a script prints more."""
    missing = [
        f"{pattern}: no such file"
        for pattern in entry["files"]
        if not any(ROOT.glob(pattern))
    ]
    if "check" in entry:
        file = ROOT / entry["script"]
        sys.path.insert(0, str(file.parent))
        if importlib.import_module(file.stem).main(entry["check"]):
            missing.append(f"{entry['script']} {' '.join(entry['check'])} failed")
    elif "inputs" in entry and (found := hash_of(entry["inputs"])) != entry["sha256"]:
        missing.append(
            f"{', '.join(entry['files'])}: {', '.join(entry['inputs'])} changed. Run {entry['script']}, then set "
            f"sha256 to {found} in {TABLE.name}"
        )
    return missing


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the checks; return the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--list", action="store_true", help="print the table, and check nothing"
    )
    options = parser.parse_args(arguments)
    found = []
    for entry in entries():
        if options.list:
            how = entry.get("measured") or (
                "checked" if "check" in entry else "inputs checked"
            )
            print(f"{entry['script']}: {', '.join(entry['files'])} ({how})")
        else:
            found += faults(entry)
    for fault in found:
        print(fault, file=sys.stderr)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
