"""A PLY file's header, read before its data: does the file hold what it announces?"""

from __future__ import annotations

from pathlib import Path

from mrbatch.errors import InputError, Place

_PLY_BYTES = {
    "char": 1, "uchar": 1, "int8": 1, "uint8": 1, "short": 2, "ushort": 2, "int16": 2, "uint16": 2,
    "int": 4, "uint": 4, "int32": 4, "uint32": 4, "float": 4, "float32": 4, "double": 8, "float64": 8,
}  # fmt: skip


def check_ply_header(path: Path, size: int, place: Place) -> None:
    """Refuses a PLY file whose counts need more bytes than it has, before anything is allocated.

    `size`: of the whole file, bytes. Raises InputError, also for a header that cannot be read.
    """
    with path.open("rb") as file:
        if file.readline(16).strip() != b"ply":
            raise InputError("not a PLY file", place=place, hint="its first line must be `ply`")
        binary, needed, count, header = False, 0, 0, 0
        ended = False
        while header < 4096:
            line = file.readline(4096)
            if not line:
                break
            header += 1
            words = line.split()
            if not words:
                continue
            if words[0] == b"end_header":
                ended = True
                break
            try:
                if words[0] == b"format":
                    binary = words[1] != b"ascii"
                elif words[0] == b"element":
                    count = int(words[2])
                    if count < 0:
                        raise ValueError
                elif words[0] == b"property":
                    kind = words[1].decode("ascii")
                    smallest = _PLY_BYTES[words[2].decode("ascii") if kind == "list" else kind]
                    needed += count * (smallest if binary else 2)
            except (IndexError, ValueError, KeyError, UnicodeDecodeError):
                raise InputError(f"line {header + 1} of the PLY header cannot be read", place=place) from None
        if not ended:
            raise InputError(
                "the PLY header has no end", place=place, hint="the file is damaged or truncated"
            )
        # A text file may leave out its last line's end.
        there = size - file.tell()
        if needed > there + (0 if binary else 1):
            raise InputError(
                f"the PLY header announces at least {needed} bytes of data, the file has {there}",
                place=place,
                hint="the file is truncated: copy or export it again",
            )
