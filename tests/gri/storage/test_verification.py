"""Damage is noticed before anything is used."""

import hashlib
import json
import os

import pytest

from gri.errors import InputError
from gri.storage import verification
from gri.storage.verification import (
    DamagedError,
    check_digest,
    check_own_digest,
    digest,
    is_intact,
    read_sealed,
    read_value,
    sealed,
    set_aside,
    write_digest,
    write_sealed,
)


def flipped(content: bytes, bit: int) -> bytes:
    changed = bytearray(content)
    changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)


@pytest.mark.parametrize(
    ("content", "read"), [({"a": [0.1, None, "ü"], "b": {"c": True}}, read_sealed), ({"value": [1, 2.5]}, read_value)]
)
def test_no_flipped_bit_of_a_sealed_file_changes_what_is_read(tmp_path, content, read):
    path = tmp_path / "facts.json"
    write_sealed(path, content)
    whole, wanted = path.read_bytes(), read(path, "")
    for bit in range(8 * len(whole)):
        path.write_bytes(flipped(whole, bit))
        try:
            found = read(path, "do it again")
        except InputError as error:
            assert str(error).splitlines()[-1].endswith("do it again")  # noqa: PT017
            continue
        named = {key: value for key, value in found.items() if key in content} if read is read_sealed else found
        assert named == wanted  # the name of the hash was hit: then the content cannot be


def test_files_of_older_versions_have_no_hash_and_are_read(tmp_path):
    (tmp_path / "old.json").write_text('{"a": 1}')
    (tmp_path / "list.json").write_text("[1, 2]")
    assert read_sealed(tmp_path / "old.json", "") == {"a": 1}
    assert read_value(tmp_path / "list.json", "") == [1, 2]
    assert is_intact(tmp_path / "list.json", pytest.fail)


def test_a_value_has_a_field_of_its_own_and_older_files_are_values_themselves(tmp_path):
    path = tmp_path / "a.json"
    path.write_text('{"a": 1}')
    assert read_value(path, "") == {"a": 1}
    path.write_text('{"value": 3}')
    assert read_value(path, "") == 3
    write_sealed(path, {"value": 3, "other": 4})
    with pytest.raises(DamagedError, match=r"not in the field value\); do it again"):
        read_value(path, "do it again")


def test_a_sealed_file_is_readable_and_can_be_sealed_again(tmp_path):
    path = tmp_path / "a.json"
    write_sealed(path, {"b": [1, 2], "a": {"c": None}})
    content = json.loads(path.read_text())
    assert list(content) == ["b", "a", "own_sha256"]
    assert path.read_text() == json.dumps(content, indent=2) + "\n"
    assert sealed(content) == content
    assert sealed({"a": 1, "b": 2})["own_sha256"] == sealed({"b": 2, "a": 1})["own_sha256"]


def test_what_is_not_there_is_not_intact_and_not_said(tmp_path):
    assert not is_intact(tmp_path / "a.json", pytest.fail)


def test_a_hash_without_its_file_is_left_to_the_reader_of_the_file(tmp_path):
    (tmp_path / "table").write_bytes(b"rows")
    write_digest(tmp_path / "table")
    assert (tmp_path / "table.sha256").read_text() == f"{hashlib.sha256(b'rows').hexdigest()}  table\n"
    (tmp_path / "table").unlink()
    assert check_own_digest(tmp_path / "table", "") == tmp_path / "table"
    (tmp_path / "table").write_bytes(b"rows")
    (tmp_path / "table.sha256").write_text("")
    with pytest.raises(InputError, match="make it again"):
        check_own_digest(tmp_path / "table", "make it again")


def test_a_damaged_file_is_renamed_and_said_once(tmp_path):
    said = []
    write_sealed(tmp_path / "a.json", {"x": 1})
    assert is_intact(tmp_path / "a.json", said.append)
    (tmp_path / "a.json").write_text((tmp_path / "a.json").read_text().replace('"x": 1', '"x": 2'))
    assert not is_intact(tmp_path / "a.json", said.append)
    assert not is_intact(tmp_path / "a.json", said.append)
    assert len(said) == 1
    assert os.listdir(tmp_path) == ["a.json.damaged"]


def test_set_aside_takes_a_free_name(tmp_path):
    for name in ("run.damaged", "run.damaged-2", "run.damaged-3"):
        (tmp_path / "run").mkdir()
        assert set_aside(tmp_path / "run").name == name
    for k in range(4, 80):
        (tmp_path / f"run.damaged-{k}").touch()
    (tmp_path / "run").mkdir()
    assert set_aside(tmp_path / "run").name == "run.damaged-80"


def test_a_hash_is_computed_again_only_when_the_file_has_changed(tmp_path, monkeypatch):
    path = tmp_path / "table"
    path.write_bytes(b"rows")
    os.utime(path, (1e9, 1e9))
    first, computed = digest(path), []
    monkeypatch.setattr(verification, "_content_hash", lambda path: computed.append(path) or "new")
    assert digest(path) == first
    assert not computed
    os.utime(path, (1e9, 1e9 + 1))
    assert digest(path) == digest(path) == "new"
    assert len(computed) == 1
    path.write_bytes(b"ROWS")
    assert digest(path) == digest(path) == "new"
    assert len(computed) == 3  # its time may be the same after the next change


@pytest.mark.parametrize("jump", [-1e6, -3600.0, 0.0, 3600.0, 1e9], ids="{:g} s".format)
def test_a_clock_that_jumps_hides_no_change(tmp_path, monkeypatch, jump):
    """The clock jumps after a file was written, and is back at the very same instant when it is written again."""
    path = tmp_path / "table"
    path.write_bytes(b"rows")
    instant = path.stat().st_mtime
    monkeypatch.setattr(verification.time, "time", lambda: instant + jump)
    before = digest(path)
    assert digest(path) == before
    path.write_bytes(b"ROWS")
    os.utime(path, (instant, instant))
    assert digest(path) != before


def test_a_missing_or_changed_file_is_damaged(tmp_path):
    path = tmp_path / "table"
    with pytest.raises(DamagedError, match="No such file"):
        check_digest(path, "0", "")
    path.write_bytes(b"rows")
    assert check_own_digest(path, "") == path  # no hash beside it: older, or given by the user
    write_digest(path)
    assert check_own_digest(path, "") == path
    path.write_bytes(b"ROWS")
    with pytest.raises(DamagedError, match=r"table: is damaged .*; make it again"):
        check_own_digest(path, "make it again")
