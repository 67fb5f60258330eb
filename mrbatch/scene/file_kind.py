"""What a file is by its first bytes, so that a refusal can say it in words of its own.

The libraries that read pictures and videos complain in terms of their own insides; a person wants to
know that the file is empty, that it is text, that it is of another kind, or that it is cut short.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from mrbatch.errors import InputError, Place

_SIGNATURES: tuple[tuple[int, bytes, str], ...] = (
    (0, b"\x76\x2f\x31\x01", "EXR"),
    (0, b"\x89PNG\r\n\x1a\n", "PNG"),
    (0, b"\xff\xd8\xff", "JPEG"),
    (0, b"II*\0", "TIFF"),
    (0, b"MM\0*", "TIFF"),
    (0, b"II+\0", "TIFF"),
    (0, b"#?", "HDR"),
    (0, b"PF\n", "PFM"),
    (0, b"Pf\n", "PFM"),
    (0, b"SDPX", "DPX"),
    (0, b"XPDS", "DPX"),
    (0, b"GIF8", "GIF"),
    (8, b"WEBP", "WebP"),
    (8, b"AVI ", "AVI"),
    (4, b"ftyp", "MP4"),
    (4, b"moov", "MP4"),
    (0, b"\x1a\x45\xdf\xa3", "Matroska"),
    (0, b"%PDF", "PDF"),
    (0, b"PK\x03\x04", "ZIP"),
    (0, b"\x1f\x8b", "gzip"),
    (0, b"ply\n", "PLY"),
    (0, b"ply\r", "PLY"),
    (0, b"glTF", "glTF"),
)
"""Offset, bytes and the name that people know the kind by."""
PICTURES = ("EXR", "HDR", "PNG", "JPEG", "TIFF", "PFM", "DPX")
VIDEOS = ("MP4", "Matroska", "AVI")
EMPTY, TEXT = "empty", "text"


def file_kind(path: Path) -> str:
    """`EXR`, `PNG`, ..., `empty`, `text`, or nothing where the first bytes tell nothing."""
    try:
        with Path(path).open("rb") as file:
            head = file.read(4096)
    except OSError:
        return ""
    if not head:
        return EMPTY
    for offset, signature, kind in _SIGNATURES:
        if head[offset : offset + len(signature)] == signature:
            return kind
    return TEXT if _is_text(head) else ""


def _is_text(head: bytes) -> bool:
    """Whether these are UTF-8 letters; the last of them may be cut."""
    try:
        letters = head.decode("utf-8")
    except UnicodeDecodeError as error:
        if len(head) - error.start >= 4 or error.start == 0:
            return False
        letters = head[: error.start].decode("utf-8")
    return all(letter.isprintable() or letter in "\t\n\r\f" for letter in letters)


def unreadable(path: Path, wanted: str, kinds: Collection[str], *, place: Place | None = None) -> InputError:
    """The error for a file that a library refused, in our words.

    `wanted`: what the file should be, with its article: `a picture`. `kinds`: names of `file_kind` that
    are read here. `place`: where the error is, by default the file.
    """
    kind = file_kind(path)
    read = ", ".join(kinds)
    if kind == EMPTY:
        message, hint = f"this is not {wanted}: the file is empty", "copy or export it again"
    elif kind == TEXT:
        message, hint = f"this is not {wanted} but text", f"check the path; read are {read}"
    elif kind and kind not in kinds:
        message, hint = f"this is not {wanted} but {_with_article(kind)} file", f"read are {read}"
    elif kind:
        message = f"cannot read the file: it begins as {_with_article(kind)} file but is damaged or cut short"
        hint = "copy or export it again"
    else:
        message, hint = f"this is not {wanted}, or it is damaged from the start", f"read are {read}"
    return InputError(message, place=place or Place(file=str(path)), hint=hint)


def _with_article(kind: str) -> str:
    return f"an {kind}" if kind in ("EXR", "HDR", "MP4", "AVI") else f"a {kind}"
