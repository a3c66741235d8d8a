"""Which check catches each planted fault first, and what its diagnosis says, as a Markdown table.

    python -m studies.planted_faults.planted_faults
    python -m studies.planted_faults.planted_faults --backend newton --only "rope-*" --only margin
    python -m studies.planted_faults.planted_faults --backend genesis --own-check --only "cloth-*"

With `--own-check`, each mutant runs the one check that is stored with its fault. Exit code 1 when a fault survives.
Faults of MuJoCo's model are left out on another backend.
"""

from __future__ import annotations

import argparse
import sys
from fnmatch import fnmatchcase
from pathlib import Path

from gauge_envs.backends import backend
from gauge_envs.pages.text import markdown_row
from gauge_envs.tools.conformance import checks

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
from mutations import FAULTS, Mutant, first_failure

LONGEST_DIAGNOSIS = 160


def _shortened(text: str) -> str:
    """Return the beginning of a diagnosis, up to a whole word."""
    if len(text) <= LONGEST_DIAGNOSIS:
        return text
    return text[:LONGEST_DIAGNOSIS].rsplit(" ", 1)[0] + " ..."


def main() -> int:
    """Print the table and the numbers of faults that are caught and named."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--backend", default="mujoco")
    parser.add_argument(
        "--only",
        action="append",
        default=[],
        help="id or pattern of faults; repeatable",
    )
    parser.add_argument(
        "--own-check",
        action="store_true",
        help="run only the check that is stored with each fault",
    )
    arguments = parser.parse_args()
    engine = backend(arguments.backend)
    chosen = {
        name: fault
        for name, fault in FAULTS.items()
        if fault.engine in ("", arguments.backend)
        and (
            not arguments.only
            or any(fnmatchcase(name, pattern) for pattern in arguments.only)
        )
    }
    print(markdown_row(["fault", "caught by", "diagnosis", "named"]))
    print(markdown_row(["---"] * 4))
    survivors, named = [], 0
    for name, fault in chosen.items():
        result = first_failure(
            Mutant(engine, fault), only=[fault.caught_by] if arguments.own_check else ()
        )
        if result is None:
            survivors.append(name)
            print(markdown_row([fault.what, "none", "", "no"]), flush=True)
            continue
        is_named = fault.says in result.diagnosis
        named += is_named
        row = [
            fault.what,
            result.check,
            _shortened(result.diagnosis),
            "yes" if is_named else "no",
        ]
        print(markdown_row(row), flush=True)
    run = "one check each" if arguments.own_check else f"{len(checks())} checks"
    print(
        f"\n{len(chosen)} faults on {engine.name}, {run}: {len(chosen) - len(survivors)} caught, "
        f"{named} named by the first diagnosis. Survivors: {', '.join(survivors) or 'none'}."
    )
    return 1 if survivors else 0


if __name__ == "__main__":
    sys.exit(main())
