"""What the bare ray queries of a pass cost: rays are noted while it runs, then cast again by nothing but
a loop. The share of the pass's time that the loop takes is what no faster kernel can save."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from mrbatch.device import embree

RECORD = np.dtype(
    {
        "names": ["o", "d", "tfar", "kind", "scene"],
        "formats": [("<f4", 3), ("<f4", 3), "<f4", "<u4", "<u8"],
        "itemsize": 40,
    }
)

_REPLAY_SOURCE = """
    struct Record { float o[3], d[3], tfar; unsigned kind; unsigned long long scene; };
    struct alignas(16) RayHit {
        float ox, oy, oz, tnear, dx, dy, dz, time, tfar; unsigned mask, id, flags;
        float nx, ny, nz, u, v; unsigned prim, geom, inst[8];
    } r;
    typedef void (*Function)(void*, void*, void*);
    const Record* records = (const Record*)rays;
    long long hits = 0;
    for (long long i = first; i < last; ++i) {
        const Record& q = records[i];
        r.ox = q.o[0]; r.oy = q.o[1]; r.oz = q.o[2]; r.tnear = 0.0f;
        r.dx = q.d[0]; r.dy = q.d[1]; r.dz = q.d[2]; r.time = 0.0f; r.tfar = q.tfar;
        r.mask = 0xffffffffu; r.id = 0; r.flags = 0; r.geom = 0xffffffffu; r.inst[0] = 0xffffffffu;
        ((Function)(q.kind == 0 ? intersect : occluded))((void*)q.scene, &r, (void*)0);
        hits += q.kind == 0 ? r.geom != 0xffffffffu : r.tfar < 0.0f;
    }
    return hits;
"""


@wp.func_native(_REPLAY_SOURCE)
def _replay(
    rays: wp.uint64, first: wp.int64, last: wp.int64, intersect: wp.uint64, occluded: wp.uint64
) -> wp.int64: ...


@wp.kernel(enable_backward=False, module="unique")
def _replay_kernel(
    rays: wp.uint64,
    first: wp.int64,
    last: wp.int64,
    intersect: wp.uint64,
    occluded: wp.uint64,
    hits: wp.array(dtype=wp.int64),
):
    hits[0] = _replay(rays, first, last, intersect, occluded)


class RayLog:
    """Memory for `capacity` noted rays; `attach` gives it to the ray sets of a scene."""

    def __init__(self, capacity: int) -> None:
        self._block = np.zeros(16 + capacity * RECORD.itemsize, dtype=np.uint8)
        self._head = self._block[:16].view("<i8")
        self._head[0] = capacity

    def attach(self, scene_data: Any) -> None:
        address = wp.uint64(self._block.ctypes.data)
        for name in ("camera_set", "all_set", "real_set", "virtual_set"):
            ray_set = getattr(scene_data, name)
            ray_set.log = address
            setattr(scene_data, name, ray_set)

    @property
    def count(self) -> int:
        """Rays that came, noted or not."""
        return int(self._head[1])

    @property
    def rays(self) -> np.ndarray:
        """The noted rays, `RECORD`s in the order in which they were cast."""
        n = min(self.count, int(self._head[0]))
        return self._block[16 : 16 + n * RECORD.itemsize].view(RECORD)


@dataclass(frozen=True)
class Replayed:
    seconds: float
    hits: int
    rays: int


def replay(rays: np.ndarray, threads: int = 1, pieces: int = 16) -> Replayed:
    """Casts noted rays again in their order, on `threads`; seconds of wall time."""
    library = embree.library()
    wp.load_module(_replay_kernel.module, "cpu", block_dim=1)
    n = len(rays)
    edges = np.linspace(0, n, pieces * threads + 1).astype(np.int64)
    address = wp.uint64(rays.ctypes.data)
    outs = [wp.zeros(1, dtype=wp.int64, device="cpu") for _ in range(len(edges) - 1)]

    def one(i: int) -> None:
        wp.launch(
            _replay_kernel,
            1,
            [
                address,
                wp.int64(edges[i]),
                wp.int64(edges[i + 1]),
                wp.uint64(library.intersect),
                wp.uint64(library.occluded),
                outs[i],
            ],
            device="cpu",
        )

    with ThreadPoolExecutor(threads) as pool:
        start = time.perf_counter()
        list(pool.map(one, range(len(outs))))
        seconds = time.perf_counter() - start
    return Replayed(seconds, sum(int(o.numpy()[0]) for o in outs), n)
