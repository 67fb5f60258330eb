"""Which pictures are compared with which: two files, or the frames that two folders share."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from mrbatch.errors import InputError, Place
from mrbatch.report.pictures import SUFFIXES

PREVIEWS = ("contact_sheet.png",)
"""Pictures of a job's folder that are no frames."""


@dataclass(frozen=True)
class Pair:
    """A picture, its reference, and the reference without virtual objects where there is one."""

    name: str
    number: int
    test: Path
    reference: Path
    without: Path | None


@dataclass(frozen=True)
class Pairs:
    """The pairs found, and by folder the names that others have and it lacks."""

    found: tuple[Pair, ...]
    missing: tuple[tuple[str, tuple[str, ...]], ...] = ()

    def notes(self) -> tuple[str, ...]:
        """A sentence for each folder that lacks pictures."""
        return tuple(f"the {what} lacks {_few(names)}: not compared" for what, names in self.missing)


def find_pairs(test: Path, reference: Path, without: Path | None = None, *, every: bool = False) -> Pairs:
    """Two files, or the pictures of two folders that have the same names.

    In folders that hold EXR files, only these are frames: the previews beside them are not compared. What
    one folder lacks is left out and told, or with `every` refused.

    Raises InputError where one is a file and the other a folder, the folders share no picture, or with
    `every` one lacks any.
    """
    test, reference = Path(test), Path(reference)
    for path in filter(None, (test, reference, without)):
        if not Path(path).exists():
            raise InputError(
                "there is no such file or folder", place=Place(file=str(path)), hint="check the path"
            )
    if test.is_dir() != reference.is_dir() or (without and Path(without).is_dir() != test.is_dir()):
        raise InputError(
            "a file can be compared with a file only, a folder with a folder",
            place=Place(file=str(test)),
            hint=f"the reference is {reference}",
        )
    if not test.is_dir():
        return Pairs((Pair(test.name, _number(test, 1), test, reference, without),))
    folders = {"test folder": test, "reference folder": reference}
    if without:
        folders["folder without objects"] = Path(without)
    names = _frame_names(folders)
    for what, those in names.items():
        if not those:
            raise InputError(
                "the folder has no pictures",
                place=Place(file=str(folders[what])),
                hint=f"read are {', '.join(SUFFIXES)}",
            )
    together = set().union(*names.values())
    shared = set(together).intersection(*names.values())
    missing = tuple((what, tuple(sorted(together - those))) for what, those in names.items())
    missing = tuple((what, lacking) for what, lacking in missing if lacking)
    if not shared:
        examples = " and ".join(f"`{min(those)}`" for those in names.values())
        raise InputError(
            "the folders share no picture name",
            place=Place(file=str(test)),
            hint=f"pictures of the same name are compared; here are {examples}",
        )
    if every and missing:
        what, lacking = missing[0]
        raise InputError(
            f"the {what} lacks {_few(lacking)}",
            place=Place(file=str(folders[what])),
            hint="without `--all` the pictures that all folders hold are compared",
        )
    chosen = sorted(shared)
    frame_numbers = [_number(test / name, i + 1) for i, name in enumerate(chosen)]
    if len(set(frame_numbers)) != len(chosen):
        frame_numbers = list(range(1, len(chosen) + 1))
    return Pairs(
        tuple(
            Pair(name, number, test / name, reference / name, Path(without) / name if without else None)
            for name, number in zip(chosen, frame_numbers)
        ),
        missing,
    )


def _frame_names(folders: dict[str, Path]) -> dict[str, set[str]]:
    """By folder the names of its frames."""
    names = {}
    for what, folder in folders.items():
        files = (p for p in folder.iterdir() if p.is_file() and not p.name.startswith("."))
        names[what] = {p.name for p in files if p.suffix.lower() in SUFFIXES and p.name not in PREVIEWS}
    exr = {what: {n for n in those if n.lower().endswith(".exr")} for what, those in names.items()}
    return exr if all(exr.values()) else names


def _few(names: tuple[str, ...], most: int = 3) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def _number(path: Path, otherwise: int) -> int:
    """The frame number at the end of a name such as `desk.0012.exr`."""
    match = re.search(r"(\d{1,9})$", path.stem)
    return int(match.group(1)) if match else otherwise
