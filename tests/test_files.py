"""Files are written completely or not at all, and errors of pydantic become a place and a reason."""

from __future__ import annotations

import csv
import io
from typing import Literal

import numpy as np
import pytest
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from gauge_envs.files import npz_arrays, write_whole
from gauge_envs.text import csv_text
from gauge_envs.validation import first_fault


def test_a_failed_write_leaves_the_old_content(tmp_path, monkeypatch):
    file = tmp_path / "a.json"
    write_whole(file, b"old")

    def crash(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("gauge_envs.files.Path.write_bytes", crash)
    with pytest.raises(OSError, match="No space left"):
        write_whole(file, b"new")
    assert file.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [file]
    monkeypatch.undo()
    write_whole(file, b"new")
    assert file.read_bytes() == b"new"


@pytest.mark.parametrize("dtype", ["f8", ">f4", "i2", "u1", "?"])
def test_named_arrays_are_read_and_texts_are_rejected(dtype):
    values = np.asarray(np.arange(12).reshape(3, 4) % 2, dtype=dtype)
    stream = io.BytesIO()
    np.savez(stream, a=values, b=values, text="words")
    content = stream.getvalue()
    (array,) = npz_arrays(content, ["a", "gone"]).values()
    np.testing.assert_array_equal(array, values)
    assert array.dtype == values.dtype
    with pytest.raises(ValueError, match="text: it has <U5 values, expected numbers"):
        npz_arrays(content)
    for damaged in (b"", b"words", b"PK", content[:-30]):
        with pytest.raises(ValueError, match=r"(?i)zip"):
            npz_arrays(damaged)


class Circle(BaseModel):
    kind: Literal["circle"]
    radius: float = Field(gt=0)


class Line(BaseModel):
    kind: Literal["line"]


class Drawing(BaseModel):
    model_config = ConfigDict(extra="forbid")

    name: str = Field(max_length=3)
    first: Circle | Line | None = Field(default=None, discriminator="kind")


@pytest.mark.parametrize(
    ("values", "place", "reason"),
    [
        ({}, "name", "missing key"),
        ({"name": "a", "colour": 1}, "colour", "unknown key"),
        ({"nam": "a"}, "nam", "unknown key; did you mean name?"),
        ({"colour": 1}, "colour", "unknown key; known: name"),
        ({"name": "a", "first": {}}, "first.kind", "missing key"),
        (
            {"name": "a", "first": {"kind": "circle", "radius": -1}},
            "first.circle.radius",
            " (given: -1)",
        ),
        ({"name": "x" * 99}, "name", ""),
        (3, "", " (given: 3)"),
    ],
)
def test_the_first_fault_has_a_place_and_a_reason(values, place, reason):
    with pytest.raises(ValidationError) as caught:
        Drawing.model_validate(values)
    actual_place, actual_reason = first_fault(caught.value)
    # The text before the value is from pydantic.
    assert actual_place == place
    assert actual_reason.endswith(reason)
    assert actual_reason == reason or "key" not in reason


@pytest.mark.parametrize(
    "content",
    [
        b"# 1; 2\nframe,mean.x\n0,1.5\n",
        b"\xef\xbb\xbf# 1; 2\r\nframe,mean.x\r\n0,1.5\r\n",
        b"# 1; 2\nframe;mean.x\n0;1.5\n",
        b"\xef\xbb\xbf# 1; 2\r\nframe;mean.x\r\n0;1,5\r\n",
    ],
)
def test_csv_of_a_spreadsheet_is_read(content):
    assert [row for row in csv.reader(csv_text(content)) if row[0][0] != "#"] == [
        ["frame", "mean.x"],
        ["0", "1.5"],
    ]
