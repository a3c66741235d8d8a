"""YAML files: plain values only, and tags that run nothing."""

import pytest

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity.stacks.documents import (
    read_yaml,
    yaml_document,
)


def test_tuples_slices_and_aliases_are_data():
    text = """
    gravity: !!python/tuple [0.0, 0.0, -9.81]
    joints: !!python/object/apply:builtins.slice [null, null, null]
    one: &id001 {x: 1}
    other: *id001
    """
    assert yaml_document(text) == {
        "gravity": (0.0, 0.0, -9.81),
        "joints": None,
        "one": {"x": 1},
        "other": {"x": 1},
    }


@pytest.mark.parametrize(
    "tag",
    [
        "!!python/object/apply:os.system ['touch RAN']",
        "!!python/object/apply:builtins.open ['RAN', 'w']",
        "!!python/object/new:os.system ['touch RAN']",
        "!!python/object:collections.Counter {}",
        "!!python/name:os.system ''",
        "!!python/module:os ''",
        "!!python/object/apply:builtins.slice.x [1]",
        "!!python/tupl [1]",
    ],
)
def test_every_other_tag_of_python_is_refused(tag, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "env.yaml").write_text(f"sim:\n  dt: {tag}\n")
    with pytest.raises(TargetError, match=r"env\.yaml: it is no YAML: .*python/"):
        read_yaml(tmp_path / "env.yaml")
    assert not (tmp_path / "RAN").exists()


def test_a_slice_is_never_called():
    assert yaml_document(
        "a: !!python/object/apply:builtins.slice {args: [1, 2], state: {x: 1}}"
    ) == {"a": None}


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("a: *x", "it is no YAML: "),
        ("a: 1\n---\nb: 2", "it is no YAML: "),
        ("a: !unknown 1", "it is no YAML: "),
        ("a: 2020-99-99", ""),
        ("a: !!bool x", "it is no YAML: "),
        ("a: !!timestamp x", ""),
        ("a: \x00", "no YAML"),
        ("? [a]\n: 1", "it is no YAML: "),
        (b"\xff\xfe\x00", ""),
    ],
    ids=lambda value: str(value)[:20].strip(),
)
def test_what_is_damaged_is_an_error(text, reason, tmp_path):
    file = tmp_path / "env.yaml"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    # Where the words are those of a library, the file is ours to name.
    with pytest.raises(TargetError, match=rf"env\.yaml: .*({reason})"):
        read_yaml(file)


def test_files_that_cannot_be_read_are_named(tmp_path):
    for name, reason in {
        "absent.yaml": "no such file",
        ".": "cannot be read",
    }.items():
        with pytest.raises(TargetError, match=reason):
            read_yaml(tmp_path / name)
