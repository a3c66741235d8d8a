"""Write `tests/cli/schemas.json`: the version and a digest of the JSON Schema of each output.

A change of what a command prints with `--json` raises `version` in the `instrument.toml`; a test compares the two.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from gauge_envs.cli.schemas import output_schema, schema_names
from scripts.generated import ROOT, not_raised

LEDGER = ROOT / "tests" / "cli" / "schemas.json"


def current() -> dict[str, dict[str, Any]]:
    """Return the version and the digest of each schema; other words in a description change none."""
    found = {}
    for name, version in schema_names().items():
        text = json.dumps(_without_words(output_schema(name)), sort_keys=True)
        digest = hashlib.sha256(text.encode()).hexdigest()[:16]
        found[name] = {"version": version, "digest": digest}
    return found


def _without_words(schema: Any) -> Any:
    """Return a schema without descriptions and without its version; a property may have such a name."""
    if isinstance(schema, list):
        return [_without_words(one) for one in schema]
    if not isinstance(schema, dict):
        return schema
    return {
        key: _without_words(value)
        for key, value in schema.items()
        if key != "$id" and not (key == "description" and isinstance(value, str))
    }


def contents() -> dict[Path, str]:
    """Return the ledger.

    Raises:
        ValueError: A schema changed, and its version is the same.
    """
    found = current()
    stated = json.loads(LEDGER.read_text(encoding="utf-8")) if LEDGER.exists() else {}
    if kept := not_raised(stated, found, "version"):
        raise ValueError(
            f"raise `version` in [outputs] of an instrument.toml: {', '.join(kept)}"
        )
    return {LEDGER: json.dumps(found, indent=1, sort_keys=True) + "\n"}
