"""Files and folders that appear whole or not at all."""

import os
import stat

import pytest

from gri.storage.whole_files import part_beside, publish, sweep, whole_file, write_whole


def test_a_file_appears_whole_or_not_at_all(tmp_path):
    path = tmp_path / "a.txt"
    write_whole(path, "früher")
    with pytest.raises(ZeroDivisionError), whole_file(path) as part:  # noqa: PT012
        part.write_text("half")
        raise ZeroDivisionError
    assert path.read_text(encoding="utf-8") == "früher"
    assert os.listdir(tmp_path) == ["a.txt"]


def test_files_and_their_folder_are_on_the_disk_before_they_appear(tmp_path, monkeypatch):
    order = []
    monkeypatch.setattr(os, "fsync", lambda handle: order.append(os.readlink(f"/proc/self/fd/{handle}")))
    replace = os.replace
    monkeypatch.setattr(os, "replace", lambda *where: (order.append("moved"), replace(*where)))
    part = part_beside(tmp_path / "run")
    part.mkdir()
    (part / "table").write_text("rows")
    publish(part, tmp_path / "run")
    assert order == [str(part / "table"), str(part), "moved", str(tmp_path)]


def test_a_folder_never_replaces_one_with_content(tmp_path):
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "table").write_text(name)
    with pytest.raises(OSError, match="not empty"):
        publish(tmp_path / "one", tmp_path / "two")
    assert (tmp_path / "two/table").read_text() == "two"


def test_folders_of_a_file_are_made_and_nothing_is_left_of_a_file_that_was_never_begun(tmp_path):
    write_whole(tmp_path / "a/b/c.txt", b"x")
    with pytest.raises(ZeroDivisionError), whole_file(tmp_path / "a/b/d.txt"):
        raise ZeroDivisionError
    assert os.listdir(tmp_path / "a/b") == ["c.txt"]


def test_what_a_link_points_to_is_neither_removed_nor_flushed(tmp_path):
    (tmp_path / "results").mkdir()
    (tmp_path / "results/table").write_text("rows")
    (tmp_path / ".run.1-abc.part").symlink_to(tmp_path / "results")
    sweep(tmp_path)
    assert sorted(os.listdir(tmp_path)) == ["results"]
    assert (tmp_path / "results/table").read_text() == "rows"
    part = part_beside(tmp_path / "run")
    part.mkdir()
    (part / "link").symlink_to(tmp_path / "nowhere")
    publish(part, tmp_path / "run")
    assert (tmp_path / "run/link").is_symlink()


@pytest.mark.parametrize("what", ["open", "fsync"])
def test_a_file_that_cannot_be_flushed_does_not_appear_but_folders_need_not_be(tmp_path, monkeypatch, what):
    """Windows opens no folders, and some file systems flush none."""
    plain = getattr(os, what)

    def failing(kind: int):
        def fail(target, *options):
            mode = os.fstat(target).st_mode if what == "fsync" else os.stat(target).st_mode
            if stat.S_IFMT(mode) == kind:
                raise OSError(5, "Input/output error")
            return plain(target, *options)

        return fail

    with monkeypatch.context() as broken:
        part = part_beside(tmp_path / "run")
        part.mkdir()
        (part / "table").write_text("rows")
        broken.setattr(os, what, failing(stat.S_IFREG))
        with pytest.raises(OSError, match="Input/output"):
            publish(part, tmp_path / "run")
        assert not (tmp_path / "run").exists()
        broken.setattr(os, what, failing(stat.S_IFDIR))
        publish(part, tmp_path / "run")
    assert (tmp_path / "run/table").read_text() == "rows"


def test_what_cannot_be_removed_is_left(tmp_path, monkeypatch):
    def busy(*_, **__):
        raise OSError(16, "Device or resource busy")

    (tmp_path / ".run.1-abc.part").mkdir()
    with monkeypatch.context() as broken:
        broken.setattr(os, "rmdir", busy)
        sweep(tmp_path)
    assert os.listdir(tmp_path) == [".run.1-abc.part"]


def test_only_unfinished_files_are_swept(tmp_path):
    kept = ["run", "x.part", ".hidden", part_beside(tmp_path / "other").name]
    for name in (*kept, part_beside(tmp_path / "run").name):
        (tmp_path / name).touch()
    part_beside(tmp_path / "run").mkdir()
    sweep(tmp_path, "run")
    assert sorted(os.listdir(tmp_path)) == sorted(kept)
    sweep(tmp_path)
    assert sorted(os.listdir(tmp_path)) == sorted(kept[:3])


def test_names_as_long_as_the_system_allows_can_be_written(tmp_path):
    path = tmp_path / ("ü" * 127)
    write_whole(path, b"x")
    assert path.read_bytes() == b"x"


@pytest.mark.skipif(not os.path.isdir("/proc/self/fd"), reason="needs /proc")
def test_no_descriptor_stays_open(tmp_path):
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(5):
        write_whole(tmp_path / "a", "text")
    assert len(os.listdir("/proc/self/fd")) == before
