"""Video: the frame table against what players show, and colours against the standards' formulas.

Videos are made here with PyAV. Each frame's number is written into its own grey level, so that a
wrong frame cannot pass for the right one.
"""

from __future__ import annotations

import struct
from fractions import Fraction

import numpy as np
import pytest

from mrbatch.capture.marker_video.colour import Colour, signal_from_yuv, upsample_chroma
from mrbatch.capture.marker_video.settings import ColourSettings
from mrbatch.capture.marker_video.video import FrameTable, VideoReader, build_frame_table
from mrbatch.errors import InputError
from mrbatch.kernels.transfer import to_linear

av = pytest.importorskip("av")


def set_planes(frame, planes):
    for plane, values in zip(frame.planes, planes):
        values = np.ascontiguousarray(values)
        rows = np.zeros((plane.height, plane.line_size), np.uint8)
        raw = values.view(np.uint8).reshape(values.shape[0], -1)
        rows[: raw.shape[0], : raw.shape[1]] = raw
        plane.update(rows.tobytes())
    return frame


def write(
    path,
    codec,
    fmt,
    frames,
    *,
    pts=None,
    time_base=Fraction(1, 25),
    options=None,
    tags=None,
    turn=0,
    movflags="",
):
    """`frames`: a list of tuples of plane arrays."""
    height, width = frames[0][0].shape[:2]
    with av.open(str(path), "w", options={"movflags": movflags} if movflags else {}) as container:
        stream = container.add_stream(codec, rate=25)
        stream.width, stream.height, stream.pix_fmt = width, height, fmt
        stream.options = options or {}
        stream.codec_context.time_base = time_base
        for name, value in (tags or {}).items():
            setattr(stream.codec_context, name, value)
        if turn:
            stream.set_display_rotation(turn)
        for i, planes in enumerate(frames):
            frame = set_planes(av.VideoFrame(width, height, fmt), planes)
            frame.pts, frame.time_base = (pts[i] if pts else i), time_base
            for name, value in (tags or {}).items():
                setattr(frame, name, value)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def grey_frames(count, width=64, height=48, chroma=(2, 2)):
    size = (-(-height // chroma[1]), -(-width // chroma[0]))
    c = np.full(size, 128, np.uint8)
    return [(np.full((height, width), 40 + 4 * i, np.uint8), c, c) for i in range(count)]


B_FRAMES = {"bf": "3", "g": "12", "x264-params": "b-adapt=0:scenecut=0:keyint=12:bframes=3", "crf": "1"}


def level(frame) -> int:
    plane = frame.planes[0]
    return round(float(np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)[8:40, 8:40].mean()))


def check_levels(path, wanted, order=None):
    """All frames in the given order carry their own grey level."""
    table = build_frame_table(path)
    assert len(table) == len(wanted)
    with VideoReader(path, table) as reader:
        for i in order if order is not None else range(len(wanted)):
            assert abs(level(reader.frame(i)) - wanted[i]) <= 1, i
    return table


@pytest.mark.parametrize(
    ("name", "codec", "options"),
    [
        ("a.mp4", "libx264", B_FRAMES),
        ("a.mkv", "libx264", B_FRAMES),
        ("a.avi", "mpeg4", {"bf": "2", "qscale": "1", "flags": "+qscale", "g": "10"}),
        ("a.mp4", "libx265", {"x265-params": "keyint=10:bframes=3:open-gop=1:log-level=none:crf=2"}),
        ("a.mp4", "libx264", {"x264-params": "open-gop=1:keyint=10:bframes=3:b-adapt=0", "crf": "1"}),
        ("a.mkv", "ffv1", {}),
        ("a.ts", "libx264", B_FRAMES),
    ],
)
def test_reordered_frames_in_any_order(tmp_path, name, codec, options):
    path = write(tmp_path / name, codec, "yuv420p", grey_frames(40), options=options)
    wanted = [40 + 4 * i for i in range(40)]
    shuffled = np.random.default_rng(5).permutation(40)
    table = check_levels(path, wanted, [*shuffled, 39, 38, 37, 0, 1, 2])
    check_levels(path, wanted)
    steps = np.diff([float(table.time(i)) for i in range(40)])
    np.testing.assert_allclose(steps, 0.04, atol=0.0006)  # Matroska rounds to milliseconds
    assert FrameTable.from_json(table.as_json()) == table


def test_packets_really_are_reordered(tmp_path):
    path = write(tmp_path / "a.mp4", "libx264", "yuv420p", grey_frames(20), options=B_FRAMES)
    table = build_frame_table(path)
    assert list(table.order) != sorted(table.order)


def test_variable_frame_rate_keeps_exact_times(tmp_path):
    pts = [0, 1001, 2002, 9009, 9010, 30030, 40000, 40001]
    path = write(
        tmp_path / "vfr.mp4",
        "libx264",
        "yuv420p",
        grey_frames(8),
        pts=pts,
        time_base=Fraction(1, 30000),
        options=B_FRAMES,
    )
    table = check_levels(path, [40 + 4 * i for i in range(8)], [7, 3, 4, 0])
    assert [table.time(i) for i in range(8)] == [Fraction(p, 30000) for p in pts]


def find_box(data: bytes, names: list[bytes], start: int = 0, end: int | None = None) -> tuple[int, int]:
    """(start of content, end) of a nested MP4 box."""
    end = len(data) if end is None else end
    at = start
    while at < end:
        size, kind = struct.unpack(">I4s", data[at : at + 8])
        if kind == names[0]:
            return (at + 8, at + size) if len(names) == 1 else find_box(data, names[1:], at + 8, at + size)
        at += size
    raise KeyError(names)


def test_edit_list_drops_what_a_player_does_not_show(tmp_path):
    """The edit's media time is moved to the 15th frame, as a lossless trim does: 14 frames vanish,
    though decoding still needs them from the key frame on."""
    path = write(tmp_path / "cut.mp4", "libx264", "yuv420p", grey_frames(40), options=B_FRAMES)
    data = bytearray(path.read_bytes())
    start, _ = find_box(bytes(data), [b"moov", b"trak", b"edts", b"elst"])
    assert struct.unpack(">I", data[start + 4 : start + 8])[0] == 1
    duration, media_time = struct.unpack(">Ii", data[start + 8 : start + 16])
    per_frame = 12800 // 25
    shift = 14 * per_frame
    timescale = struct.unpack(">I", data[find_box(bytes(data), [b"moov", b"mvhd"])[0] + 12 :][:4])[0]
    struct.pack_into(">Ii", data, start + 8, duration - 14 * timescale // 25, media_time + shift)
    path.write_bytes(data)
    wanted = [40 + 4 * i for i in range(14, 40)]
    table = check_levels(path, wanted)
    check_levels(path, wanted, np.random.default_rng(1).permutation(len(wanted)))
    assert table.packets > 26  # those from the key frame on are there, marked as not shown
    assert table.time(0) == 0


def test_a_file_cut_short_is_noted(tmp_path):
    whole = write(
        tmp_path / "a.mp4", "libx264", "yuv420p", grey_frames(40), options=B_FRAMES, movflags="faststart"
    )
    with VideoReader(whole, build_frame_table(whole)) as reader:
        assert not [n for n in reader.probe(ColourSettings()).notes if "cut" in n]
    (tmp_path / "cut.mp4").write_bytes(whole.read_bytes()[:-150])
    table = build_frame_table(tmp_path / "cut.mp4")
    assert 0 < len(table) < 40
    with VideoReader(tmp_path / "cut.mp4", table) as reader:
        assert [n for n in reader.probe(ColourSettings()).notes if "cut" in n]


def test_start_offset_is_kept_in_the_times(tmp_path):
    pts = [50 + i for i in range(10)]
    path = write(tmp_path / "late.mp4", "libx264", "yuv420p", grey_frames(10), pts=pts, options=B_FRAMES)
    table = check_levels(path, [40 + 4 * i for i in range(10)])
    assert table.time(0) == 2
    assert table.time(9) == Fraction(59, 25)


def bars():
    """R'G'B' primaries, secondaries and greys."""
    return np.array(
        [[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [0, 1, 1], [1, 0, 1], [0.5, 0.5, 0.5], [0.2, 0.6, 0.4]]
    )


STANDARD_WEIGHTS = {"bt709": (0.2126, 0.7152, 0.0722), "bt601": (0.299, 0.587, 0.114)}
STANDARD_WEIGHTS["bt2020"] = (0.2627, 0.678, 0.0593)


def yuv_codes(rgb, name, bits, full):
    """Encoder's side, written from the standards: E'Y, E'Cb, E'Cr and their quantization."""
    kr, kg, kb = STANDARD_WEIGHTS[name]
    r, g, b = rgb[..., 0], rgb[..., 1], rgb[..., 2]
    y = kr * r + kg * g + kb * b
    cb, cr = (b - y) / (2 * (1 - kb)), (r - y) / (2 * (1 - kr))
    if full:
        top = 2**bits - 1
        codes = [top * y, top * cb + 2 ** (bits - 1), top * cr + 2 ** (bits - 1)]
    else:
        s = 2 ** (bits - 8)
        codes = [s * (219 * y + 16), s * (224 * cb + 128), s * (224 * cr + 128)]
    return [np.clip(np.round(c), 0, 2**bits - 1).astype(np.uint8 if bits == 8 else np.uint16) for c in codes]


@pytest.mark.parametrize("full", [False, True])
@pytest.mark.parametrize("bits", [8, 10])
@pytest.mark.parametrize("name", ["bt709", "bt601", "bt2020"])
def test_lossless_colours_by_tag(tmp_path, name, bits, full):
    """Bars through ffv1: tags, range, bits and matrix come back within the codes' own rounding."""
    rgb = np.repeat(np.repeat(bars()[None], 6, 0), 2, 1)
    planes = yuv_codes(rgb, name, bits, full)
    fmt = "yuv444p" if bits == 8 else "yuv444p10le"
    code = {"bt709": 1, "bt601": 6, "bt2020": 9}[name]
    tags = {"colorspace": code, "color_range": 2 if full else 1, "color_trc": 13, "color_primaries": 1}
    path = write(tmp_path / "bars.mkv", "ffv1", fmt, [tuple(planes)], tags=tags)
    table = build_frame_table(path)
    with VideoReader(path, table) as reader:
        info = reader.probe(ColourSettings(transfer="linear"))
        picture = reader.picture(0, info)
    assert (info.colour.matrix, info.colour.range) == (name, "full" if full else "limited")
    assert info.colour.bits == bits
    assert picture.codes is None
    step = 1.0 / (2**bits - 1 if full else 219 * 2 ** (bits - 8))
    assert np.abs(picture.linear - rgb).max() < 1.6 * step
    white_like = picture.linear[0, 12]
    assert np.ptp(white_like) == 0.0  # grey has no colour cast, to the bit


def test_black_and_white_of_limited_range_are_exact():
    y = np.array([[0, 16, 126, 235, 255]], np.uint8)
    c = np.full((1, 5), 128, np.uint8)
    got = signal_from_yuv(y, c, c, Colour("srgb", 8, matrix="bt709", range="limited"))
    np.testing.assert_array_equal(got[0, [0, 1, 3, 4], 0], [0, 0, 1, 1])
    assert got[0, 2, 0] == np.float32(110 / 219)


@pytest.mark.parametrize(
    ("siting", "x0", "y0"), [("left", 0.0, 0.5), ("centre", 0.5, 0.5), ("top-left", 0.0, 0.0)]
)
@pytest.mark.parametrize("shape", [(12, 16), (11, 15)])
def test_chroma_lies_where_it_was_sampled(siting, x0, y0, shape):
    """A ramp a x + b y sampled at the chroma sites comes back on luma's grid, away from the edges."""
    h, w = shape
    rows, columns = -(-h // 2), -(-w // 2)
    ramp = 3.0 * (x0 + 2 * np.arange(columns))[None, :] + 5.0 * (y0 + 2 * np.arange(rows))[:, None]
    got = upsample_chroma(ramp.astype(np.float32), (2, 2), siting, shape)
    truth = 3.0 * np.arange(w)[None, :] + 5.0 * np.arange(h)[:, None]
    assert got.shape == shape
    np.testing.assert_array_equal(got[2:-2, 2:-2], truth[2:-2, 2:-2])


@pytest.mark.parametrize("siting", ["left", "centre", "top-left"])
def test_tagged_siting_is_seen(tmp_path, siting):
    loc = {"left": 0, "centre": 1, "top-left": 2}[siting]
    options = {"x264-params": f"chromaloc={loc}", "crf": "10"}
    path = write(tmp_path / "loc.mp4", "libx264", "yuv420p", grey_frames(2), options=options)
    with VideoReader(path, build_frame_table(path)) as reader:
        assert reader.probe(ColourSettings()).colour.chroma == siting


def test_settings_override_tags_and_assumptions_are_noted(tmp_path):
    path = write(tmp_path / "a.mkv", "ffv1", "yuv420p", grey_frames(1))
    with VideoReader(path, build_frame_table(path)) as reader:
        auto = reader.probe(ColourSettings())
        chosen = reader.probe(
            ColourSettings(transfer="srgb", matrix="bt2020", range="full", chroma="top-left", primaries="p3")
        )
    c = auto.colour
    assert (c.transfer, c.matrix, c.range, c.chroma) == ("bt709", "bt601", "limited", "left")
    assert len(auto.notes) == 4
    c = chosen.colour
    assert (c.transfer, c.matrix, c.range, c.chroma) == ("srgb", "bt2020", "full", "top-left")
    assert c.primaries == "p3"
    assert c.rec709_from_source[0][0] > 1.2
    assert chosen.notes == ()


@pytest.mark.parametrize(
    ("codec", "fmt", "bits"),
    [("libx264rgb", "rgb24", 8), ("ffv1", "bgr0", 8), ("ffv1", "gbrp10le", 10), ("ffv1", "rgb48le", 16)],
)
def test_lossless_rgb_keeps_its_codes(tmp_path, codec, fmt, bits):
    rng = np.random.default_rng(2)
    dtype = np.uint8 if bits == 8 else np.uint16
    rgb = rng.integers(0, 2**bits, (17, 31, 3)).astype(dtype)
    if fmt == "bgr0":
        planes = (np.concatenate([rgb[..., ::-1], np.zeros((17, 31, 1), np.uint8)], axis=2),)
    elif fmt.startswith("gbrp"):
        planes = (rgb[..., 1], rgb[..., 2], rgb[..., 0])
    else:
        planes = (rgb,)
    path = write(tmp_path / "rgb.mkv", codec, fmt, [planes], options={"qp": "0"} if "x264" in codec else {})
    with VideoReader(path, build_frame_table(path)) as reader:
        info = reader.probe(ColourSettings())
        picture = reader.picture(0, info)
    np.testing.assert_array_equal(picture.codes, rgb)
    assert info.colour.transfer == "srgb"
    np.testing.assert_array_equal(picture.linear, to_linear(rgb, "srgb", bits))


@pytest.mark.parametrize("fmt", ["yuv420p", "yuv422p", "yuv440p", "yuv411p", "yuv410p", "gray", "gray10le"])
def test_odd_sizes(tmp_path, fmt):
    """33 x 19: a row and a column of chroma cover half a sample; planes are padded in memory."""
    fx, fy = {"420": (2, 2), "422": (2, 1), "440": (1, 2), "411": (4, 1), "410": (4, 4)}.get(fmt[3:6], (1, 1))
    dtype, zero, span = (np.uint16, 0, 1023) if fmt == "gray10le" else (np.uint8, 16, 219)
    if fmt == "gray":
        zero, span = 0, 255
    y = (zero + np.add.outer(np.arange(19), np.arange(33))).astype(dtype)
    c = np.full((-(-19 // fy), -(-33 // fx)), 128, np.uint8)
    path = write(tmp_path / "odd.mkv", "ffv1", fmt, [(y, c, c)])
    with VideoReader(path, build_frame_table(path)) as reader:
        info = reader.probe(ColourSettings(transfer="linear"))
        got = reader.picture(0, info).linear
    truth = (y.astype(np.float64) - zero) / span
    assert got.shape == (19, 33, 3)
    for channel in range(3):
        assert np.abs(got[..., channel] - truth).max() < 1e-6


def test_nv12_is_as_yuv420p(tmp_path):
    """x264 stores NV12 input as yuv420p; the raw layout is read from a frame made in memory."""
    from mrbatch.capture.marker_video.planes import PIXEL_FORMATS, picture_of

    rng = np.random.default_rng(4)
    y, cb, cr = (rng.integers(16, 236, s).astype(np.uint8) for s in [(20, 36), (10, 18), (10, 18)])
    colour = Colour("bt709", 8, matrix="bt709", range="limited", chroma="left")
    planar = set_planes(av.VideoFrame(36, 20, "yuv420p"), (y, cb, cr))
    paired = set_planes(av.VideoFrame(36, 20, "nv12"), (y, np.stack([cb, cr], -1).reshape(10, 36)))
    a, b = (picture_of(f, PIXEL_FORMATS[n], colour) for f, n in [(planar, "yuv420p"), (paired, "nv12")])
    np.testing.assert_array_equal(a.linear, b.linear)
    ten = Colour("bt709", 10, matrix="bt709", range="limited", chroma="left")
    wide = [p.astype(np.uint16) * 4 + 1 for p in (y, cb, cr)]
    high = set_planes(
        av.VideoFrame(36, 20, "p010le"),
        (wide[0] << 6, np.stack([wide[1], wide[2]], -1).reshape(10, 36) << 6),
    )
    planar = set_planes(av.VideoFrame(36, 20, "yuv420p10le"), wide)
    c, d = (picture_of(f, PIXEL_FORMATS[n], ten) for f, n in [(high, "p010le"), (planar, "yuv420p10le")])
    np.testing.assert_array_equal(c.linear, d.linear)


def test_coded_colours_are_near(tmp_path):
    """H.264 with 4:2:0, colour patches of 32 pixels: inside them within two codes."""
    rgb = np.repeat(np.repeat(bars()[None] * 0.8 + 0.1, 32, 0), 32, 1)
    y, cb, cr = yuv_codes(rgb, "bt709", 8, False)
    tags = {"colorspace": 1, "color_range": 1, "color_trc": 1, "color_primaries": 1}
    path = write(
        tmp_path / "b.mp4",
        "libx264",
        "yuv420p",
        [(y, cb[::2, ::2], cr[::2, ::2])],
        options={"crf": "4"},
        tags=tags,
    )
    with VideoReader(path, build_frame_table(path)) as reader:
        info = reader.probe(ColourSettings())
        assert (info.colour.transfer, info.notes) == ("bt709", ())
        linear = reader.picture(0, info).linear
    v = rgb[16, 16::32]
    truth = np.where(v < 0.0812429, v / 4.5, ((v + 0.0992968) / 1.0992968) ** (1 / 0.45))
    assert np.abs(linear[16, 16::32] - truth).max() < 0.03


@pytest.mark.parametrize("degrees", [90, 180, 270])
def test_quarter_turns_are_applied(tmp_path, degrees):
    y = np.zeros((32, 48), np.uint8)
    y[:16, :24] = 255  # top left as stored
    c = np.full((16, 24), 128, np.uint8)
    path = write(tmp_path / "r.mov", "libx264", "yuv420p", [(y, c, c)], options={"crf": "1"}, turn=degrees)
    with VideoReader(path, build_frame_table(path)) as reader:
        info = reader.probe(ColourSettings())
        linear = reader.picture(0, info).linear
        player = np.rot90(y, round(reader.frame(0).rotation / 90))  # FFmpeg's own angle, counter-clockwise
    assert info.turn in (1, 2, 3)
    assert linear.shape[:2] == player.shape == (info.height, info.width)
    np.testing.assert_array_equal(linear[4::8, 4::8, 1] > 0.5, player[4::8, 4::8] > 128)


def test_missing_and_broken_files(tmp_path):
    with pytest.raises(InputError, match="there is no such video"):
        build_frame_table(tmp_path / "none.mp4")
    (tmp_path / "text.mp4").write_text("this is no video" * 50)
    with pytest.raises(InputError, match="not a video but text"):
        build_frame_table(tmp_path / "text.mp4")
    whole = write(tmp_path / "a.mp4", "libx264", "yuv420p", grey_frames(10)).read_bytes()
    (tmp_path / "cut.mp4").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError):
        build_frame_table(tmp_path / "cut.mp4")
    odd = write(
        tmp_path / "odd.mkv", "ffv1", "yuva420p", [(*grey_frames(1)[0], np.full((48, 64), 255, np.uint8))]
    )
    with (
        VideoReader(odd, build_frame_table(odd)) as reader,
        pytest.raises(InputError, match="pixel format yuva420p is not supported"),
    ):
        reader.probe(ColourSettings())


def test_a_damaged_frame_costs_itself_and_what_needs_it(tmp_path):
    """Packet 14 of a stream with key frames every 10 and no reordering is wiped: 14 to 19 are lost, the
    same ones whether frames are read in order or one by one."""
    options = {"x264-params": "keyint=10:min-keyint=10:scenecut=0:bframes=0", "crf": "1"}
    path = write(tmp_path / "a.mp4", "libx264", "yuv420p", grey_frames(30), options=options)
    table = build_frame_table(path)
    with av.open(str(path)) as container:
        packets = [(p.pos, p.size) for p in container.demux(video=0) if p.size]
    data = bytearray(path.read_bytes())
    pos, size = packets[14]
    data[pos : pos + size] = bytes(size)
    path.write_bytes(data)

    def lost(order):
        found = set()
        with VideoReader(path, table) as reader:
            for i in order:
                try:
                    assert abs(level(reader.frame(i)) - (40 + 4 * i)) <= 1
                except InputError as error:
                    assert error.place.frame == i
                    assert "pts" in error.message
                    found.add(int(i))
        return found

    assert lost(range(30)) == set(range(14, 20))
    assert lost(np.random.default_rng(3).permutation(30)) == set(range(14, 20))
    for i in (13, 14, 17, 20):
        assert lost([i]) == ({i} & set(range(14, 20)))


@pytest.mark.parametrize(("name", "codec"), [("a.mp4", "libx264"), ("a.mkv", "ffv1"), ("a.avi", "mpeg4")])
def test_hostile_bytes_end_in_a_clear_error_or_a_picture(tmp_path, name, codec):
    whole = write(tmp_path / f"good_{name}", codec, "yuv420p", grey_frames(6)).read_bytes()
    rng = np.random.default_rng(9)
    path = tmp_path / name
    for trial in range(150):
        data = bytearray(whole)
        for at in rng.integers(0, len(data), 1 + trial % 6):
            data[at] = rng.integers(0, 256)
        path.write_bytes(data[: rng.integers(1, len(data))] if trial % 7 == 0 else data)
        try:
            with VideoReader(path, build_frame_table(path)) as reader:
                info = reader.probe(ColourSettings())
                for i in range(min(len(reader.table), 8)):
                    linear = reader.picture(i, info).linear
                    assert np.isfinite(linear).all() and linear.min() >= 0.0
        except InputError:
            continue


@pytest.mark.data
def test_the_real_panorama_video_opens(shared_data):
    path = shared_data / "rgbd360" / "kandao_room_video" / "kandao.mp4"
    if not path.is_file():
        pytest.skip("the panorama video is absent")
    table = build_frame_table(path)
    assert len(table) == 175
    with VideoReader(path, table) as reader:
        info = reader.probe(ColourSettings())
        assert (info.width, info.height) == (2160, 2160)
        picture = reader.picture(60, info)
    assert picture.linear.shape == (2160, 2160, 3)
    assert 0.01 < picture.linear[:1080].mean() < 0.9


@pytest.mark.parametrize(
    "text",
    [
        "#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\n{file}\n#EXT-X-ENDLIST\n",
        "ffconcat version 1.0\nfile {file}\n",
        '<?xml version="1.0"?><MPD xmlns="urn:mpeg:dash:schema:mpd:2011" type="static"><Period>'
        '<AdaptationSet><Representation id="1"><BaseURL>{file}</BaseURL></Representation>'
        "</AdaptationSet></Period></MPD>",
    ],
    ids=["hls", "concat", "dash"],
)
@pytest.mark.parametrize("suffix", [".mp4", ".m3u8", ".txt"])
@pytest.mark.parametrize("binary", [False, True])
def test_playlists_lead_to_no_other_file(tmp_path, text, suffix, binary):
    """Not even one that stands beside them; a byte that is no text takes them past the look at the file."""
    assert len(build_frame_table(write(tmp_path / "beside.ts", "libx264", "yuv420p", grey_frames(40)))) == 40
    content = text.format(file="beside.ts").encode()
    (tmp_path / f"list{suffix}").write_bytes(content + (b"# \xff\xfe\x00\n" if binary else b""))
    with pytest.raises(InputError, match="this is not a video"):
        build_frame_table(tmp_path / f"list{suffix}")
