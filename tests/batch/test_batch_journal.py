"""The journal: what is written is read, whatever a power cut tore."""

from __future__ import annotations

import errno
import json
import os

import pytest

from mrbatch.batch.journal import FailureEntry, FrameEntry, JournalReader, JournalWriter, RunEntry
from mrbatch.batch.presence import Owner
from mrbatch.errors import ResourceError


def entry(frame: int, job: str = "job", **more) -> FrameEntry:
    return FrameEntry(job, frame, f"a.{frame}.exr", f"sha256:{frame}", "c", 10, 1.5, **more)


def test_entries_come_back_as_they_were(tmp_path):
    owner = Owner.here()
    writer = JournalWriter(tmp_path, owner)
    writer.append(entry(1, counters={"rays": 2**60}, details={"spp": [1, 2]}, history_hash="h"))
    writer.append(FailureEntry("job", 2, "broken"))
    writer.close()
    reader = JournalReader(tmp_path)
    (found,) = reader.matching(1, "job")
    assert (found.file, found.file_hash, found.size) == ("a.1.exr", "sha256:1", 10)
    assert (found.counters, found.details) == ({"rays": 2**60}, {"spp": [1, 2]})
    assert (found.host, found.pid) == (owner.host, os.getpid())
    assert found.time > 1e9
    assert reader.failures[2][0].error == "broken"
    assert reader.matching(1, "other job") == []
    assert reader.torn_lines() == 0


def test_every_process_has_a_file_of_its_own_and_the_reader_merges(tmp_path):
    writers = [JournalWriter(tmp_path, Owner.here()) for _ in range(3)]
    reader = JournalReader(tmp_path)
    for frame in range(9):
        writers[frame % 3].append(entry(frame))
    reader.refresh()
    assert len({writer.path for writer in writers}) == 3
    assert sorted(reader.frames) == list(range(9))
    writers[0].append(entry(100))
    reader.refresh()
    assert [len(found) for found in reader.frames.values()] == [1] * 10
    for writer in writers:
        writer.close()


def test_a_line_is_there_as_soon_as_append_returns(tmp_path):
    writer = JournalWriter(tmp_path, Owner.here())
    writer.append(entry(1))
    assert writer.path.read_bytes().endswith(b"}\n")
    writer.close()


@pytest.mark.parametrize("cut", range(1, 60, 7))
def test_a_torn_last_line_is_passed_over_and_counted(tmp_path, cut):
    writer = JournalWriter(tmp_path, Owner.here())
    writer.append(entry(1))
    writer.append(entry(2))
    writer.close()
    data = writer.path.read_bytes()
    writer.path.write_bytes(data[:-cut])
    reader = JournalReader(tmp_path)
    assert sorted(reader.frames) == [1]
    assert reader.torn_lines() == 1
    # The writer may be at work on that very line.
    assert reader.torn_lines(lambda name: True) == 0


@pytest.mark.parametrize(
    "garbage",
    [
        b"\0" * 512 + b"\n",
        b"\xff\xfe\x80\n",
        b"[]\n",
        b"7\n",
        b'{"kind":"frame"}\n',
        b'{"kind":"frame","frame":"1","job_hash":"job","file":"a","file_hash":"h","content_hash":"c","size":1,"seconds":1}\n',
        b"[" * 100_000 + b"\n",
        b'{"kind":"run","job_hash":"job","seconds":"long"}\n',
        b'{"kind":"failed","job_hash":"job","frame":1,"error":7}\n',
    ],
)
def test_garbage_is_passed_over_and_what_follows_is_read(tmp_path, garbage):
    writer = JournalWriter(tmp_path, Owner.here())
    writer.append(entry(1))
    writer.close()
    data = writer.path.read_bytes()
    writer.path.write_bytes(garbage + data)
    reader = JournalReader(tmp_path)
    assert sorted(reader.frames) == [1]
    assert reader.torn_lines() == 1


def test_a_run_says_how_it_ended(tmp_path):
    """In the same file as its frames, after them, also by a writer of its own."""
    owner = Owner.here()
    told = RunEntry("job", 2.5, rendered=1, undone=(2, 3), why="the run was interrupted", exit_code=130)
    for one in (entry(1), told):
        writer = JournalWriter(tmp_path, owner)
        writer.append(one)
        writer.close()
    reader = JournalReader(tmp_path)
    assert len(list((tmp_path / "journal").iterdir())) == 1 and reader.torn_lines() == 0
    (found,) = reader.runs
    assert (found.seconds, found.undone, found.run) == (2.5, (2, 3), owner.name)
    assert found.run == reader.frames[1][0].run and found.time > 0


def test_fields_of_a_newer_version_do_no_harm(tmp_path):
    writer = JournalWriter(tmp_path, Owner.here())
    writer.append(entry(1))
    writer.close()
    record = json.loads(writer.path.read_text()) | {"novelty": 3}
    writer.path.write_text(json.dumps(record) + "\n" + json.dumps({"kind": "other"}) + "\n")
    reader = JournalReader(tmp_path)
    assert sorted(reader.frames) == [1]
    assert reader.torn_lines() == 0


def test_a_full_disk_leaves_whole_lines(tmp_path):
    writer = JournalWriter(tmp_path, Owner.here())
    writer.append(entry(1))
    before = writer.path.read_bytes()
    real = writer._file

    class Full:
        """Writes half of what it is given, then has no room."""

        def __getattr__(self, name):
            return getattr(real, name)

        def write(self, data):
            real.write(data[: len(data) // 2])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    writer._file = Full()
    with pytest.raises(ResourceError, match="disk full"):
        writer.append(entry(2))
    writer._file = real
    assert writer.path.read_bytes() == before
    writer.append(entry(3))
    writer.close()
    assert sorted(JournalReader(tmp_path).frames) == [1, 3]


def test_no_journal_is_an_empty_journal(tmp_path):
    reader = JournalReader(tmp_path)
    assert reader.frames == {}
    assert reader.torn_lines() == 0
