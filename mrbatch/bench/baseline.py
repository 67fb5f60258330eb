"""What a job's tiny renderings were when somebody last looked.

A small JSON file beside the job, to be kept under version control, that later renderings are held against.
"""

from __future__ import annotations

import json
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from mrbatch.errors import InputError, Place
from mrbatch.report.model import write_text

VERSION = 1
MAX_BYTES = 1 << 26


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class FrameBaseline(_Model):
    """One frame under several seeds, in their order. `counters` by name, and `means` of layers' channels by
    `layer.channel`: a number a seed. `tiles` (seeds, tiles * 3): means of the composite in tiles."""

    counters: dict[str, tuple[int, ...]]
    means: dict[str, tuple[float, ...]]
    tiles: tuple[tuple[float, ...], ...]
    tile_places: tuple[str, ...]


class Baseline(_Model):
    """`key`: what the job was made of, its settings and its inputs' content. `scale`, `spp`, `seeds`: how it
    was rendered. `effects`: state by name."""

    version: int = VERSION
    job: str
    key: str
    scale: float
    spp: int
    seeds: tuple[int, ...]
    effects: dict[str, str]
    frames: dict[int, FrameBaseline]

    def save(self, path: Path) -> None:
        """Raises ResourceError where it cannot be written."""
        write_text(path, json.dumps(self.model_dump(mode="json"), indent=1, sort_keys=True) + "\n")


def baseline_path(job: Path, store: Path | None) -> Path:
    """`desk.yaml` has its baseline in `desk.ci.json`, beside it or in the folder `store`."""
    return (store or job.parent) / f"{job.stem}.ci.json"


def load_baseline(path: Path) -> Baseline | None:
    """None where there is none. Raises InputError where the file is no baseline."""
    place = Place(file=str(path))
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError(f"the baseline is larger than {MAX_BYTES >> 20} MiB", place=place)
        data = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except OSError as error:
        raise InputError(f"cannot read the baseline: {error.strerror or error}", place=place) from error
    except (ValueError, RecursionError) as error:
        raise InputError("the baseline is no JSON", place=place, hint=_AGAIN) from error
    if not isinstance(data, dict) or data.get("version") != VERSION:
        raise InputError("this is no baseline of this version", place=place, hint=_AGAIN)
    try:
        found = Baseline.model_validate_json(json.dumps(data))
    except ValidationError as error:
        raise InputError("the baseline is damaged", place=place, hint=_AGAIN) from error
    lengths = {
        len(values)
        for frame in found.frames.values()
        for values in (*frame.counters.values(), *frame.means.values(), frame.tiles)
    }
    if not found.frames or lengths != {len(found.seeds)} or len(found.seeds) < 2:
        raise InputError("the baseline is damaged", place=place, hint=_AGAIN)
    return found


_AGAIN = "restore the file, or make it anew with `--update` and look at the difference"
