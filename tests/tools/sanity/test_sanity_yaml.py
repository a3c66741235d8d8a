"""YAML files of strangers: plain values only, within limits, and tags that run nothing."""

from itertools import pairwise

import pytest

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity.stacks.documents import (
    MOST_DEPTH,
    MOST_YAML_BYTES,
    read_yaml,
    yaml_document,
)

LETTERS = "abcdefghi"


def grown(value):
    """Nine lists, each of nine aliases of the one before."""
    lists = [f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]" for a, b in pairwise(LETTERS)]
    return "\n".join([f"a: &a {value}", *lists])


def merged():
    tables = [
        f"{b}: &{b} {{<<: [{', '.join([f'*{a}'] * 9)}]}}" for a, b in pairwise(LETTERS)
    ]
    return "\n".join(["a: &a {w: 1, x: 2, y: 3, z: 4}", *tables])


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
    with pytest.raises(
        TargetError,
        match=r"env\.yaml: line 2: the tag !!python/\S+ would run code; only",
    ):
        read_yaml(tmp_path / "env.yaml")
    assert not (tmp_path / "RAN").exists()


def test_a_slice_is_never_called():
    assert yaml_document(
        "a: !!python/object/apply:builtins.slice {args: [1, 2], state: {x: 1}}"
    ) == {"a": None}


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (grown("[x, x]"), "more than 50000 values"),
        (merged(), "more than 50000 values"),
        ("- 1\n" * 50_001, "more than 50000 values"),
        ("a: &a [*a]", "contains itself"),
        ("a: &a {b: {c: *a}}", "contains itself"),
        # PyYAML from 6.0.4 refuses a depth of its own choice first.
        ("[" * 50_000, f"more than {MOST_DEPTH} deep|it is no YAML: "),
        (
            "".join(f"{' ' * k}a:\n" for k in range(200)),
            f"more than {MOST_DEPTH} deep|it is no YAML: ",
        ),
        ("a: *x", "it is no YAML: "),
        ("a: 1\n---\nb: 2", "it is no YAML: "),
        ("a: !unknown 1", "is unknown"),
        ("a: 2020-99-99", ""),
        ("a: !!bool x", "cannot be read"),
        ("a: !!timestamp x", "cannot be read"),
        ("a: " + "9" * 400, "a number of more than 64 characters"),
        ("a: -0x" + "f" * 400, "a number of more than 64 characters"),
        ("a: 1" + ":59" * 100_000, "a number of more than 64 characters"),
        ("a: \x00", "no YAML"),
        ("? [a]\n: 1", "it is no YAML: "),
        ("x" * (MOST_YAML_BYTES + 1), "the limit is"),
        (b"\xff\xfe\x00", ""),
    ],
    ids=lambda value: str(value)[:20].strip(),
)
def test_what_is_damaged_or_too_large_is_an_error(text, reason, tmp_path):
    file = tmp_path / "env.yaml"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    # Where the words are those of a library, the file is ours to name.
    with pytest.raises(TargetError, match=rf"env\.yaml: .*({reason})"):
        read_yaml(file)


def test_files_that_cannot_be_read_are_named(tmp_path):
    for name, reason in {
        "absent.yaml": "no such file",
        ".": "not a regular file",
    }.items():
        with pytest.raises(TargetError, match=reason):
            read_yaml(tmp_path / name)
