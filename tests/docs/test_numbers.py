"""No page states a number that nothing regenerates.

A number with a unit, or a decimal fraction, on the README and the guides is one of these:

- a value of a source that `sources.toml` names for the page,
- shown by the page's own code, commands or generated parts,
- in the note or the tables of a study that its paragraph, row or item links, or the head or introduction of a table.

Anything else has to get such a source, or to go.
"""

from functools import partial

import pytest
import sources
from numbers_of_pages import is_among, numbers_of_study, sourceless, values
from places import ROOT

DOCS = ROOT / "docs"
PAGES = [
    ROOT / "README.md",
    *(
        page
        for page in sorted(DOCS.rglob("*.md"))
        if not {"api", "environments", "studies", "_build"}
        & set(page.relative_to(DOCS).parts)
    ),
]


def name_of(page):
    return str(page.relative_to(ROOT))


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_number_of_a_page_has_a_source(page):
    bare = sourceless(page, partial(sources.known, name_of(page)))
    assert not bare, "\n".join(
        ["Link a study, name a source in tests/docs/sources.toml, or delete:", *bare]
    )


PAGE = """# A page

A cube slides with 3.94 m/s^2, at 1/540 s, 0.19 as far, 16 384 episodes, version 2 on Python 3.11; `0.5 mm` is code.

| engine | cost |
|---|---|
| one | 12 to 14 % |
| two | 7 mm ([transfer](../studies/README.md#transfer)) |

From [transfer](../studies/README.md#transfer):

- held in 0.96, and 47 %
- held in 0.1234

<!-- table, written by scripts/x.py -->
| 0.77 |
<!-- end of table -->

The table has 0.77.

```python
print(1)  # 0.31
wait(2.5)
```

It prints 0.31 and not 2.5 s.
"""


def test_a_planted_number_is_found(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(PAGE)
    found = [
        one.partition("   in: ")[0] for one in sourceless(page, lambda _: [1.0, 540.0])
    ]
    assert found == [
        "3.94 m/s^2, 0.19, 16 384 episodes",
        "12 to 14 %",
        "7 mm",
        "0.1234",
        "2.5 s",
    ]


def test_a_number_is_known_if_it_is_rounded():
    assert is_among("0.45", [0.4512]) and not is_among("0.46", [0.4512])
    assert 0.96 in numbers_of_study("transfer")
    assert values("1,000,000 of 60 000, -3.5e-2") == (1e6, 6e4, 0.035)
