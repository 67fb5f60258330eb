"""`mrbatch info FILE...`: prints what EXR frames say of themselves."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from mrbatch.errors import InputError, Place


@click.command("info")
@click.argument("files", metavar="FILE...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print JSON: one object, or a list of several files.")
def command(files: Sequence[Path], as_json: bool) -> None:
    """Print size, windows, views, channels and metadata of EXR frames.

    Any EXR file will do; what mrbatch wrote into it is shown apart. Exit code 3: a file is no EXR.
    """
    from mrbatch.film.exr import frame_metadata

    for path in files:
        if path.is_dir():
            raise _folder(path)
    told = [{"file": str(path), **frame_metadata(path)} for path in files]
    if as_json:
        click.echo(json.dumps(told[0] if len(told) == 1 else told, indent=2, ensure_ascii=False))
        return
    for one in told:
        _show(one)


def _folder(path: Path) -> InputError:
    """What to do with a folder: name one of its frames, or ask for its report."""
    frames = sorted(p for p in path.glob("*.exr") if not p.name.startswith("."))
    hint = f"name a frame: `mrbatch info {frames[0]}`" if frames else "name an EXR frame"
    if (path / "job.json").is_file():
        hint += f"; of the whole job tells `mrbatch report {path}`"
    return InputError("this is a folder, not a frame", place=Place(file=str(path)), hint=hint)


def _show(told: Mapping[str, Any]) -> None:
    from rich.console import Console
    from rich.text import Text

    console = Console(soft_wrap=True, highlight=False)
    console.print(Text.assemble((Path(told["file"]).name, "bold"), f"  {_bytes(told['bytes'])}"))
    for part in told["parts"]:
        if len(told["parts"]) > 1:
            console.print(Text(f"\n  part {part['name'] or part['view']}", style="bold"))
        console.print(_rows(_geometry(part)))
        console.print(_heading("channels"), _rows(_layers(part["channels"])), sep="\n")
        attributes = {k: _value(k, v) for k, v in part["attributes"].items() if k not in _SHOWN_ELSEWHERE}
        if attributes:
            console.print(_heading("attributes"), _rows(attributes), sep="\n")
        if part["mrbatch"]:
            described = {k: _value(k, v) for k, v in part["mrbatch"].items()}
            console.print(_heading("mrbatch"), _rows(described), sep="\n")


_SHOWN_ELSEWHERE = {"compression", "view", "name", "type", "openexr:chunkCount", "openexr:lineOrder"}


def _heading(text: str) -> Any:
    from rich.text import Text

    return Text(f"\n  {text}", style="bold cyan")


def _rows(rows: Mapping[str, str]) -> Any:
    """Names and values in two columns; the lines of a longer value stand under each other."""
    from rich.text import Text

    text = Text()
    column = max((len(name) for name in rows), default=0)
    for i, (name, value) in enumerate(rows.items()):
        first, *others = value.split("\n")
        text.append("\n" if i else "").append(f"    {name:<{column}}", style="dim").append(f"  {first}")
        for line in others:
            text.append(f"\n    {'':<{column}}  {line}")
    return text


def _geometry(part: Mapping[str, Any]) -> dict[str, str]:
    x0, y0, width, height = part["display"]
    x, y, w, h = part["window"]
    rows = {"size": f"{width} x {height}"}
    if (x0, y0) != (0, 0):
        rows["size"] += f" from ({x0}, {y0})"
    if part["window"] != part["display"]:
        rows["data window"] = f"{w} x {h} from ({x}, {y})"
        inside = x >= x0 and y >= y0 and x + w <= x0 + width and y + h <= y0 + height
        rows["data window"] += ", a crop" if inside else ", beyond the picture"
    if part["view"]:
        rows["view"] = part["view"]
    rows["compression"] = part["compression"]
    return rows


def _layers(channels: Sequence[Mapping[str, str]]) -> dict[str, str]:
    """Channels grouped by layer: `virtual.RGBA` and its number type."""
    groups: dict[tuple[str, str], list[str]] = {}
    for channel in channels:
        layer, _, letter = channel["name"].rpartition(".")
        # A name without a dot that is no letter of a picture is a layer of one channel.
        key = layer if letter != channel["name"] or letter in "RGBAYZ" else channel["name"]
        groups.setdefault((key, channel["type"]), []).append(letter)
    rows: dict[str, str] = {}
    for (layer, kind), letters in groups.items():
        joined = ("" if all(len(letter) == 1 for letter in letters) else " ").join(letters)
        name = layer if [layer] == letters else f"{layer}.{joined}" if layer else joined
        rows[name] = kind if name not in rows else f"{rows[name]}, {kind}"
    return rows


def _value(name: str, value: Any) -> str:
    if name == "framesPerSecond" and isinstance(value, list):
        over, under = value
        return f"{over / under:.6g}" + (f" ({over}/{under})" if under != 1 else "")
    if name == "time" and isinstance(value, (int, float)):
        return f"{value:.6g} s of the footage"
    if value == []:
        return "none"
    if isinstance(value, list) and len(value) == 16 and _numbers(value):
        return "\n".join(" ".join(f"{v:10.5g}" for v in value[i : i + 4]) for i in range(0, 16, 4))
    return "\n".join(_outline(value))


def _numbers(value: Sequence[Any]) -> bool:
    return all(isinstance(v, (int, float)) for v in value)


def _outline(value: Any) -> list[str]:
    """A JSON value as lines: what is short on one line, the rest indented under its key."""
    if isinstance(value, str):
        return value.split("\n")
    if isinstance(value, float):
        return [f"{value:.6g}"]
    if isinstance(value, list) and _numbers(value):
        return [" ".join(f"{v:.6g}" for v in value)]
    if isinstance(value, dict) and list(value) == [""]:  # by view, of which there is one without a name
        return _outline(value[""])
    short = json.dumps(value, ensure_ascii=False)
    if len(short) <= 72 or not isinstance(value, (dict, list)):
        return [short]
    lines: list[str] = []
    for key, item in value.items() if isinstance(value, dict) else enumerate(value):
        inner = _outline(item)
        rows = isinstance(item, list) and bool(item) and all(isinstance(v, list) for v in item)
        if rows:  # a matrix
            inner = [line for row in item for line in _outline(row)]
        if len(inner) == 1:
            lines.append(f"{key}: {inner[0]}")
        else:
            lines.append(f"{key}:")
            lines.extend(f"  {line}" for line in inner)
    return lines


def _bytes(count: int) -> str:
    size = float(count)
    for unit in ("bytes", "kB", "MB"):
        if size < 1000:
            return f"{size:.0f} {unit}" if unit == "bytes" else f"{size:.1f} {unit}"
        size /= 1000
    return f"{size:.1f} GB"
