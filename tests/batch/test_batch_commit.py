"""A file under its final name is complete; whatever goes wrong, nothing is left aside."""

from __future__ import annotations

import errno
import hashlib
import os

import pytest

from mrbatch.batch.commit import commit_bytes, commit_file, leftovers, owner_of_temporary, temporary_name
from mrbatch.errors import InputError, ResourceError


def content(path):
    return path.read_bytes().hex()


def test_a_file_is_committed_with_its_hashes(tmp_path):
    done = commit_file(tmp_path / "a.exr", lambda path: path.write_bytes(b"abc"), content, "host-1-ff")
    assert (tmp_path / "a.exr").read_bytes() == b"abc"
    assert done.file_hash == "sha256:" + hashlib.sha256(b"abc").hexdigest()
    assert (done.content_hash, done.size) == (b"abc".hex(), 3)
    assert os.listdir(tmp_path) == ["a.exr"]


def test_the_temporary_name_lies_beside_with_the_suffix_and_tells_its_owner(tmp_path):
    temporary = temporary_name(tmp_path / "a.b.exr", "my-host-12-abcd")
    assert temporary.parent == tmp_path
    assert temporary.suffix == ".exr"
    assert owner_of_temporary(temporary.name) == "my-host-12-abcd"
    assert temporary_name(tmp_path / "a.b.exr", "my-host-12-abcd") != temporary
    assert owner_of_temporary("a.b.exr") is None


def test_the_final_name_does_not_exist_while_the_file_is_written_and_verified(tmp_path):
    final = tmp_path / "a.exr"
    seen = []

    def write(path):
        seen.append(final.exists())
        path.write_bytes(b"abc")

    def verify(path):
        seen.append(final.exists())
        return "hash"

    commit_file(final, write, verify, "host-1-ff")
    assert seen == [False, False]


@pytest.mark.parametrize("where", ["write", "verify"])
@pytest.mark.parametrize("error", [ValueError("no"), KeyboardInterrupt(), InputError("no")])
def test_a_failure_leaves_the_older_file_and_nothing_aside(tmp_path, where, error):
    final = tmp_path / "a.exr"
    final.write_bytes(b"old")

    def write(path):
        path.write_bytes(b"half")
        if where == "write":
            raise error

    def verify(path):
        raise error

    with pytest.raises(type(error)):
        commit_file(final, write, verify, "host-1-ff")
    assert final.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["a.exr"]


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (errno.ENOSPC, "disk full"),
        (errno.EACCES, "unwritable"),
        (errno.EROFS, "unwritable"),
        (errno.EMFILE, "handles"),
        (errno.EIO, "cannot write"),
    ],
)
def test_system_errors_become_resource_errors(tmp_path, number, words):
    def write(path):
        path.write_bytes(b"half")
        raise OSError(number, os.strerror(number))

    with pytest.raises(ResourceError, match=words) as caught:
        commit_file(tmp_path / "a.exr", write, None, "host-1-ff")
    assert caught.value.exit_code == 5
    assert caught.value.hint
    assert os.listdir(tmp_path) == []


def test_a_target_that_is_a_folder_is_unwritable(tmp_path):
    (tmp_path / "a.exr").mkdir()
    with pytest.raises(ResourceError):
        commit_bytes(tmp_path / "a.exr", b"abc", "host-1-ff")
    assert os.listdir(tmp_path) == ["a.exr"]


def test_leftovers_are_found_with_their_owners(tmp_path):
    mine = temporary_name(tmp_path / "a.exr", "host-1-ff")
    mine.write_bytes(b"")
    (tmp_path / "a.exr").write_bytes(b"")
    assert leftovers([tmp_path, tmp_path, tmp_path / "nowhere"]) == [(mine, "host-1-ff")]


def test_a_full_disk(mounted):
    disk = mounted("size=1m")
    commit_bytes(disk / "a.exr", b"x" * 500_000, "host-1-ff")
    with pytest.raises(ResourceError, match="disk full"):
        commit_bytes(disk / "b.exr", b"y" * 900_000, "host-1-ff")
    assert os.listdir(disk) == ["a.exr"]
    assert (disk / "a.exr").read_bytes() == b"x" * 500_000


def test_a_full_disk_behind_a_writer_that_tells_no_reason(mounted):
    disk = mounted("size=1m")

    def write(path):
        try:
            path.write_bytes(b"y" * 2_000_000)
        except OSError:
            raise RuntimeError("write failed") from None

    with pytest.raises(ResourceError, match="disk full"):
        commit_file(disk / "b.exr", write, None, "host-1-ff")
    assert os.listdir(disk) == []


def test_a_read_only_disk(mounted):
    disk = mounted("size=1m,ro")
    with pytest.raises(ResourceError, match="unwritable"):
        commit_bytes(disk / "a.exr", b"abc", "host-1-ff")
