"""Seals tell a file that was changed from one that is whole, wherever the change is."""

from __future__ import annotations

import io
import json
import math
import zipfile
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from humoslope.errors import UserError
from humoslope.seal import SUMS, beside, check_sums, finite, is_sealed, read_json, sealed, sealed_json, write_sums

REPORT = {"what": "ramps", "falls": [0, 1], "mean": 0.25, "text": "ü"}


def archive() -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as file:
        file.writestr("a.npy", b"numbers")
    return content.getvalue()


def test_a_sealed_archive_is_still_an_archive() -> None:
    with zipfile.ZipFile(io.BytesIO(sealed(archive()))) as file:
        assert file.read("a.npy") == b"numbers"


@given(data=st.data())
def test_any_flipped_bit_and_any_missing_end_breaks_the_seal_of_an_archive(data) -> None:
    whole = sealed(archive())
    assert is_sealed(whole)
    place, bit = data.draw(st.integers(0, len(whole) - 1)), data.draw(st.integers(0, 7))
    assert not is_sealed(whole[:place] + bytes([whole[place] ^ 1 << bit]) + whole[place + 1 :])
    assert not is_sealed(whole[:place])


@given(data=st.data())
def test_any_flipped_bit_and_any_missing_end_of_a_report_is_noticed_or_changes_nothing(tmp_path_factory, data) -> None:
    path, whole = tmp_path_factory.getbasetemp() / "report.json", sealed_json(REPORT).encode()
    place, bit = data.draw(st.integers(0, len(whole) - 1)), data.draw(st.integers(0, 7))
    for damaged in (whole[:place] + bytes([whole[place] ^ 1 << bit]) + whole[place + 1 :], whole[:place]):
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match="."):
            read_json(path)
    path.write_bytes(whole)
    assert read_json(path) == REPORT
    assert json.loads(whole).keys() == {*REPORT, "sha256"}


def test_what_is_not_finite_is_null_in_a_report_and_refused_in_a_result() -> None:
    measured = {"a": [1.0, math.nan, (math.inf,)], "b": {"c": -math.inf, "d": "text", "e": True, "f": None}}
    assert finite(measured) == {"a": [1.0, None, [None]], "b": {"c": None, "d": "text", "e": True, "f": None}}
    with pytest.raises(ValueError, match="not JSON compliant"):
        sealed_json(measured)


@given(data=st.data())
def test_a_list_of_checksums_that_lost_or_changed_anything_is_damaged(tmp_path_factory, data) -> None:
    folder = tmp_path_factory.getbasetemp() / "listed"
    folder.mkdir(exist_ok=True)
    for name in ("a.json", "b.json"):
        (folder / name).write_text(name)
    write_sums(folder, ["a.json", "b.json"])
    check_sums(folder)
    whole = (folder / SUMS).read_bytes()
    place, value = data.draw(st.integers(0, len(whole) - 1)), data.draw(st.integers(0, 255))
    for damaged in (whole[:place] + bytes([value]) + whole[place + 1 :], whole[:place]):
        (folder / SUMS).write_bytes(damaged)
        if damaged != whole:
            with pytest.raises(UserError):
                check_sums(folder)


def test_the_list_of_an_earlier_version_is_read(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("a")
    write_sums(tmp_path, ["a.json"])
    (tmp_path / SUMS).write_text("".join((tmp_path / SUMS).read_text().splitlines(keepends=True)[1:]))
    check_sums(tmp_path)


def test_a_file_is_compared_with_the_checksum_beside_it(tmp_path: Path) -> None:
    table = tmp_path / "curve.csv"
    table.write_text("a,b\n1,2\n")
    check_sums(tmp_path, name=beside(table))  # there is none yet
    write_sums(tmp_path, [table.name], beside(table))
    check_sums(tmp_path, name=beside(table))
    table.write_text("a,b\n1,3\n")
    with pytest.raises(UserError, match=r"curve.csv' is damaged or was changed .*; draw it anew, or, if a change is"):
        check_sums(tmp_path, "draw it anew, or", beside(table))
    table.unlink()
    with pytest.raises(UserError, match=r"curve.csv', which '.*curve.csv.sha256' lists, cannot be read"):
        check_sums(tmp_path, name=beside(table))
