"""Embree, called from inside Warp kernels through function pointers.

The wheel `embreex` carries Embree 4 with its whole C API. A kernel calls `rtcIntersect1` and
`rtcOccluded1` directly: no queue, no copy, no interpreter lock, any thread. The device is opened
with a fixed instruction set, because hits differ in the last bits between instruction sets and a
picture must not depend on the machine.
"""

from __future__ import annotations

import ctypes
import functools
import importlib.metadata
from pathlib import Path

import numpy as np

from mrbatch.errors import ResourceError

INSTRUCTION_SET = "avx2"
_GEOMETRY_TRIANGLES = 0
_BUFFER_INDEX, _BUFFER_VERTEX = 0, 1
_FORMAT_UINT3, _FORMAT_FLOAT3 = 0x5003, 0x9003
_FLAG_ROBUST = 1 << 2
_PROPERTY_VERSION = 0


def _library_path() -> Path:
    try:
        import embreex.rtcore  # noqa: F401  (loads the libraries that libembree4 needs)
    except ImportError as error:
        raise ResourceError(
            f"the ray engine Embree cannot be loaded ({error})",
            hint="install the wheel `embreex`, or render with --set engine=warp",
        ) from error
    for file in importlib.metadata.files("embreex") or ():
        if "libembree4" in file.name or file.name.lower().startswith("embree4"):
            return Path(str(file.locate()))
    raise ResourceError(
        "the wheel `embreex` carries no Embree 4 library",
        hint="reinstall `embreex`, or render with --set engine=warp",
    )


class EmbreeLibrary:
    """The C API, bound once a process; `device` is shared by all scenes."""

    def __init__(self) -> None:
        lib = ctypes.CDLL(str(_library_path()))
        pointer, size = ctypes.c_void_p, ctypes.c_size_t
        signatures = {
            "rtcNewDevice": (pointer, [ctypes.c_char_p]),
            "rtcGetDeviceError": (ctypes.c_int, [pointer]),
            "rtcGetDeviceProperty": (ctypes.c_ssize_t, [pointer, ctypes.c_int]),
            "rtcNewScene": (pointer, [pointer]),
            "rtcSetSceneFlags": (None, [pointer, ctypes.c_int]),
            "rtcNewGeometry": (pointer, [pointer, ctypes.c_int]),
            "rtcSetSharedGeometryBuffer": (
                None,
                [pointer, ctypes.c_int, ctypes.c_uint, ctypes.c_int, pointer, size, size, size],
            ),
            "rtcCommitGeometry": (None, [pointer]),
            "rtcAttachGeometryByID": (None, [pointer, pointer, ctypes.c_uint]),
            "rtcReleaseGeometry": (None, [pointer]),
            "rtcCommitScene": (None, [pointer]),
            "rtcReleaseScene": (None, [pointer]),
        }
        for name, (result, arguments) in signatures.items():
            function = getattr(lib, name)
            function.restype, function.argtypes = result, arguments
        self.api = lib
        self.device = lib.rtcNewDevice(f"isa={INSTRUCTION_SET}".encode())
        if not self.device:
            raise ResourceError(
                f"Embree cannot open a device with the instruction set {INSTRUCTION_SET}",
                hint="render with --set engine=warp",
            )
        self.version = int(lib.rtcGetDeviceProperty(self.device, _PROPERTY_VERSION))
        if self.version // 10000 != 4:
            raise ResourceError(
                f"Embree {self.version} is not supported: version 4 is needed",
                hint="install embreex 4.4, or render with --set engine=warp",
            )
        self.intersect = ctypes.cast(lib.rtcIntersect1, ctypes.c_void_p).value or 0
        self.occluded = ctypes.cast(lib.rtcOccluded1, ctypes.c_void_p).value or 0


@functools.cache
def library() -> EmbreeLibrary:
    """The bound library. Raises ResourceError where it cannot be had."""
    return EmbreeLibrary()


class EmbreeScene:
    """A set of triangle meshes under one hierarchy.

    `meshes`: for each the id that a hit reports, vertices (n, 4) float32 (the fourth is padding)
    and faces (m, 3) uint32; the arrays are shared with Embree and kept alive here.
    """

    def __init__(self, meshes: list[tuple[int, np.ndarray, np.ndarray]]) -> None:
        self._library = library()
        api = self._library.api
        self._kept = meshes
        self.handle = api.rtcNewScene(self._library.device)
        api.rtcSetSceneFlags(self.handle, _FLAG_ROBUST)
        for identity, vertices, faces in meshes:
            if vertices.dtype != np.float32 or vertices.shape[1] != 4 or not vertices.flags.c_contiguous:
                raise TypeError("vertices must be contiguous float32 (n, 4)")
            if faces.dtype != np.uint32 or faces.shape[1] != 3 or not faces.flags.c_contiguous:
                raise TypeError("faces must be contiguous uint32 (m, 3)")
            geometry = api.rtcNewGeometry(self._library.device, _GEOMETRY_TRIANGLES)
            api.rtcSetSharedGeometryBuffer(
                geometry, _BUFFER_VERTEX, 0, _FORMAT_FLOAT3, vertices.ctypes.data, 0, 16, len(vertices)
            )
            api.rtcSetSharedGeometryBuffer(
                geometry, _BUFFER_INDEX, 0, _FORMAT_UINT3, faces.ctypes.data, 0, 12, len(faces)
            )
            api.rtcCommitGeometry(geometry)
            api.rtcAttachGeometryByID(self.handle, geometry, identity)
            api.rtcReleaseGeometry(geometry)
        api.rtcCommitScene(self.handle)
        error = api.rtcGetDeviceError(self._library.device)
        if error:
            raise ResourceError(f"Embree could not build the scene (error {error})")

    def __del__(self) -> None:
        handle, self.handle = getattr(self, "handle", None), None
        if handle:
            self._library.api.rtcReleaseScene(handle)


# Embree writes within the first 84 bytes of RTCRayHit (instance id and instance primitive id come
# last); the array is longer so that a library built for deeper instancing stays inside it too.
INTERSECT_SOURCE = """
    struct alignas(16) RayHit {
        float ox, oy, oz, tnear, dx, dy, dz, time, tfar; unsigned mask, id, flags;
        float nx, ny, nz, u, v; unsigned prim, geom, inst[8];
    } r;
    r.ox = o[0]; r.oy = o[1]; r.oz = o[2]; r.tnear = 0.0f;
    r.dx = d[0]; r.dy = d[1]; r.dz = d[2]; r.time = 0.0f; r.tfar = tfar;
    r.mask = 0xffffffffu; r.id = 0; r.flags = 0; r.geom = 0xffffffffu; r.inst[0] = 0xffffffffu;
    typedef void (*Function)(void*, void*, void*);
    ((Function)function)((void*)scene, &r, (void*)0);
    wp::vec_t<5, float> hit;
    union { unsigned bits; float value; } mesh, face;
    mesh.bits = r.geom; face.bits = r.prim;
    hit[0] = r.tfar; hit[1] = r.u; hit[2] = r.v; hit[3] = mesh.value; hit[4] = face.value;
    return hit;
"""
"""Body of a native Warp function (function, scene, o, d, tfar) -> t, u, v, mesh and face as bits."""

OCCLUDED_SOURCE = """
    struct alignas(16) Ray {
        float ox, oy, oz, tnear, dx, dy, dz, time, tfar; unsigned mask, id, flags;
    } r;
    r.ox = o[0]; r.oy = o[1]; r.oz = o[2]; r.tnear = 0.0f;
    r.dx = d[0]; r.dy = d[1]; r.dz = d[2]; r.time = 0.0f; r.tfar = tfar;
    r.mask = 0xffffffffu; r.id = 0; r.flags = 0;
    typedef void (*Function)(void*, void*, void*);
    ((Function)function)((void*)scene, &r, (void*)0);
    return r.tfar < 0.0f;
"""
"""Body of a native Warp function (function, scene, o, d, tfar) -> bool."""

RECORD_SOURCE = """
    // Block at `log`: capacity and count (int64), then rays of 10 words: o, d, tfar, scene, kind.
    long long* head = (long long*)log;
    long long i = head[1]++;
    if (i < head[0]) {
        struct Record { float o[3], d[3], tfar; unsigned kind; unsigned long long scene; };
        Record* r = (Record*)(head + 2) + i;
        for (int c = 0; c < 3; ++c) { r->o[c] = o[c]; r->d[c] = d[c]; }
        r->tfar = tfar; r->kind = (unsigned)kind; r->scene = scene;
    }
    return true;
"""
"""Body of a native Warp function (log, scene, o, d, tfar, kind) -> bool: notes a ray (one thread only)."""
