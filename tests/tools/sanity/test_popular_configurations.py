"""The table of popular configurations: its data, its page, and the script that writes both."""

import json

from scripts import build_popular_configurations as script
from scripts.generated import stale_files


def test_a_changed_value_makes_the_page_stale(tmp_path, monkeypatch):
    data = script.stored()
    row = next(one for one in data["rows"] if "creep-wood" in one["values"])
    row["values"]["creep-wood"] += 1.0
    changed = tmp_path / "data.json"
    changed.write_text(json.dumps(data))
    monkeypatch.setattr(script, "DATA", changed)
    assert stale_files(script.contents()) == [script.PAGE]


def test_all_packages_are_in_the_data_with_their_versions():
    rows = json.loads(script.DATA.read_text())["rows"]
    assert {row["package"] for row in rows} == set(script.PACKAGES)
    assert all(row["version"] and row["engine_version"] for row in rows)
