"""Jobs from text: what is right is read rightly, and what is wrong is shown, all at once, in place."""

from __future__ import annotations

import math
import os
import pickle
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mrbatch.document import read_document
from mrbatch.errors import EXIT_USAGE, JobErrors
from mrbatch.job import check_files, load_job, parse_job
from mrbatch.job.paths import input_paths, job_paths

FILE = Path("/work-folder/desk.yaml") if os.name != "nt" else Path("C:/work-folder/desk.yaml")
pytestmark = pytest.mark.usefixtures("toys")


def errors_of(text: str, overrides=(), **options):
    with pytest.raises(JobErrors) as caught:
        parse_job(text, FILE, overrides, shown="desk.yaml", **options)
    return caught.value.errors


def at(error) -> tuple[int | None, int | None]:
    return error.place.line, error.place.column


def position(text: str, word: str, nth: int = 0) -> tuple[int, int]:
    """Line and column, from 1, of the nth occurrence of `word`: counted here, not by the reader."""
    index = -1
    for _ in range(nth + 1):
        index = text.index(word, index + 1)
    before = text[:index]
    return before.count("\n") + 1, index - (before.rfind("\n") + 1) + 1


def test_reads_every_part(sample):
    job = parse_job(sample, FILE)
    assert (job.name, job.capture_kind, job.method_name) == ("desk", "toy-video", "toy-method")
    assert job.capture.video == FILE.parent / "desk.mp4"
    assert job.capture.marker.side == 0.06
    assert job.environment.rows == "endpoints" and math.isclose(job.environment.yaw, math.radians(30))
    assert job.real[0].reflectance == "photo" and job.real[0].plane.size == (1.2, 1.2)
    assert job.real[1].reflectance.texture == FILE.parent / "paper.png"
    assert job.real[1].reflectance.mean == (0.6, 0.6, 0.6)
    assert job.virtual[0].material.type == "conductor" and job.virtual[0].material.roughness == 0.15
    assert job.virtual[1].sphere.radius == 0.03
    assert job.method.spp == 64 and job.participants[0].type == "toy-fog"
    assert job.effects == {"shadow": "on", "glow": "off"}  # plain words, not the booleans of YAML 1.1
    assert job.frames == "1001-1100x2"
    assert job.output.directory == FILE.parent / "out"
    assert job.file == FILE and job.folder == FILE.parent
    assert job.method_object.name == "toy-method" and job.participant_objects[0].name == "toy-fog"


def test_usual_layers_are_those_the_method_gives(sample):
    job = parse_job(sample.replace("  layers: [virtual, depth]", "  dtype: half"), FILE)
    assert {"composite", "virtual", "background", "delta"} <= set(job.output.layers)
    assert "normal" not in job.output.layers


def test_name_defaults_to_the_stem(sample):
    assert parse_job(sample.replace("name: desk\n", "", 1), FILE).name == "desk"
    assert parse_job(sample.replace("name: desk\n", "", 1), FILE.with_name("a:b.yaml")).name == "a_b"


def test_job_is_frozen(sample):
    with pytest.raises(Exception, match="frozen"):
        parse_job(sample, FILE).seed = 3


def test_transform_turns_about_x_then_y_then_z(sample):
    job = parse_job(sample.replace("rotate: [90 deg, 0, 20 deg]", "rotate: [90 deg, 0, 90 deg]"), FILE)
    m = job.virtual[0].transform.world_from_object()
    # The object's y (up, in many meshes) goes to world z, then the turn about z leaves it there.
    np.testing.assert_allclose(m @ [0, 1, 0, 1], [0.01, 0, 0.5, 1], atol=1e-15)
    np.testing.assert_allclose(m @ [1, 0, 0, 1], [0.01, 0.5, 0, 1], atol=1e-15)


def test_misspelt_key(sample):
    text = sample.replace("marker: {side", "marcer: {side")
    (error,) = errors_of(text)
    assert at(error) == position(text, "marcer")
    assert "unknown key `marcer` in `capture`" in error.message and error.hint == "did you mean `marker`?"
    lines = str(error).splitlines()
    assert lines[1].strip() == "marcer: {side: 60 mm}"
    assert lines[1].index("marcer") == lines[2].index("^")


def test_misspelt_required_key_is_one_error(sample):
    (error,) = errors_of(sample.replace("video: desk", "vidoe: desk"))
    assert error.hint == "did you mean `video`?"
    (error,) = errors_of(sample.replace("sphere:", "spehre:"))
    assert error.hint == "did you mean `sphere`?"


def test_several_errors_at_once_each_in_its_place(sample):
    changes = [
        ("60 mm", "61"),
        ("endpoints", "endpoint"),
        ("roughness: 0.15", "roughness: 1.5"),
        ("spp: 64", "spp: many"),
        ("toy-fog", "toy-fgo"),
        ("virtual, depth", "virtal, depth"),
        ("frames: 1001-1100x2", "frames: 9-3"),
    ]
    text = sample
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    errors = errors_of(text)
    wrong = ["61}", "endpoint,", "1.5}", "many", "toy-fgo", "virtal", "9-3"]
    assert [at(error) for error in errors] == [position(text, word) for word in wrong]
    told = "\n".join(map(str, errors))
    for words in (
        "unit missing",
        "`endpoints`",
        "at most 1, got `1.5`",
        "expected a whole number, got `many`",
        "did you mean `toy-fog`?",
        "did you mean `virtual`?",
        "run backwards",
    ):
        assert words in told
    assert "pydantic" not in told and "Input should" not in told and "http" not in told
    assert all(error.exit_code == EXIT_USAGE for error in errors)


@pytest.mark.parametrize(
    ("old", "new", "where", "words"),
    [
        ("60 mm", "0.06", "0.06", "unit missing"),
        ("60 mm", "60 furlongs", "60 fur", "unknown unit `furlongs`"),
        ("60 mm", "[1, 2]", "[1, 2]}", "expected a length"),
        ("60 mm", "true", "true", "expected a length"),
        ("3 cm", "-3 cm", "-3 cm", "must be above 0"),
        ("spp: 64", "spp: 0", "0}", "must be at least 1, got `0`"),
        ("spp: 64", "spp: 64.5", "64.5", "expected a whole number"),
        ("spp: 64", "threshold: .nan", ".nan", "finite"),
        ("0.9, 0.6, 0.3", "0.9, 0.6", "[0.9, 0.6]", "expected 3 values, got 2"),
        ("0.9, 0.6, 0.3", "0.9, 1.6, 0.3", "1.6", "at most 1"),
        ("conductor", "conducter", "conducter", "unknown value `conducter`"),
        ("photo}", "foto}", "foto", "expected `photo`, got `foto`"),
        ("toy-video", "toy-vide", "toy-vide", "unknown capture kind"),
        ("toy-method", "toy-methd", "toy-methd", "unknown method"),
        ("kind: toy-video", "kind: toy-cloud", "toy-method", "does not take the capture kind `toy-cloud`"),
        ("glow: off", "glw: off", "glw", "unknown effect `glw`"),
        ("glow: off", "glow: never", "never", "expected `auto`, `on` or `off`"),
        ("name: ball", "name: table", "table\n", "is taken by real.0"),
        ("name: ball", "name: b.all", "b.all", "not allowed"),
        ("rows: endpoints", "world_from_map: [[1,0,0],[0,1,0],[0,0,-1]]", "[[1,0", "mirrors"),
        (
            "yaw: 30 deg",
            "align: {directions: [{map: [0.5, 0.5], world: [1, 0, 0]}, "
            "{map: [0.5, 0.501], world: [0, 0, 1]}]}",
            "{directions",
            "leaves the map free to turn",
        ),
        (
            "yaw: 30 deg",
            "align: {directions: [{map: [0.5, 0.5], world: [1, 0, 0]}, {map: [0.5, 0.9], world: [0, 0, 1]}]}",
            "{directions",
            "contradict each other",
        ),
        (
            "yaw: 30 deg",
            "align: {directions: [{map: [0.5, 0.5], world: [1, 0, 0]}, {map: [0.5, 0.9], world: [0, 0, 0]}]}",
            "[0, 0, 0]",
            "must not have the length 0",
        ),
        ("yaw: 30 deg", "align: {directions: [{map: [0.5, 0.5], world: [1, 0, 0]}]}", "[{map", "at least 2"),
        ("scale: 0.5", "scale: 0", "0}\n    material", "must not be 0"),
        ("frames: 1001", "frames: x1001", "x1001", "cannot read the frames"),
        ("name: desk", "name: ../desk", "../desk", "not allowed"),
    ],
)
def test_one_wrong_value(sample, old, new, where, words):
    text = sample.replace(old, new, 1)
    assert text != sample
    error = next(e for e in errors_of(text) if words in str(e))
    assert at(error) == position(text, where)


@pytest.mark.parametrize(
    "pattern",
    ["a.exr", "{frame}.png", "{job}.exr", "../{frame}.exr", "{frame.real}.exr", "{0}.exr",
     "{x}{frame}.exr", "{frame", "{frame:0999d}.exr"],
)  # fmt: skip
def test_wrong_file_name_patterns(sample, pattern):
    (error,) = errors_of(sample, [f"output.pattern='{pattern}'"])
    assert "output.pattern" in error.message


def test_errors_in_unions_name_one_branch(sample):
    text = sample.replace("marker: {side: 60 mm}", "gain: foo")
    (error,) = errors_of(text)
    assert "expected a number or `auto`, got `foo`" in error.message
    text = sample.replace("texture: paper.png, mean: 0.6", "texture: paper.png, maen: 0.6")
    (error,) = errors_of(text)
    assert at(error) == position(text, "maen") and error.hint == "did you mean `mean`?"


def test_two_shapes_and_another_error_are_both_shown(sample):
    text = sample.replace("sphere: {radius: 3 cm}", "sphere: {radius: 3}\n    mesh: a.ply")
    errors = errors_of(text)
    assert [at(e) for e in errors] == [position(text, "name: ball"), position(text, "3}\n    mesh")]
    assert "`mesh` and `sphere`" in errors[0].message and "unit missing" in errors[1].message
    (error,) = errors_of(sample.replace("    sphere: {radius: 3 cm}\n", ""))
    assert "no shape" in error.message


def test_missing_parts():
    errors = errors_of("name: desk")
    assert [e.message for e in errors] == ["`capture` is missing", "`method` is missing"]
    (error,) = errors_of("[1, 2]")
    assert "expected a mapping" in error.message


def test_overrides_by_index_name_and_new_part(sample):
    job = parse_job(
        sample,
        FILE,
        [
            "virtual.0.material.roughness=0.2",
            "virtual.bunny.transform.scale=2",
            "output.preview.png=true",
            "seed=1",
            "seed=7",
            "environment=null",
            "frames=[1, 5-9]",
            "output.directory=elsewhere",
            "output.scale=1/4",
        ],
    )
    assert job.virtual[0].material.roughness == 0.2 and job.virtual[0].transform.scale == (2, 2, 2)
    assert job.output.preview.png is True and job.seed == 7 and job.environment is None
    assert job.frames == "1,5-9" and job.output.directory == FILE.parent / "elsewhere"
    assert job.output.scale == 0.25


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("virtual.buny.mesh=a", "did you mean `bunny`?"),
        ("virtual.7.mesh=a", "has no item 7: it has 2"),
        ("seed", "cannot read this change"),
        ("=3", "cannot read this change"),
        ("seed=-1", "must be at least 0, got `-1`"),
        ("nmae=x", "did you mean `name`?"),
        ("environment.rows.x=3", "single value"),
        ("seed=[1", "not valid YAML"),
        ("seed=!!int 3", "tags"),
        ("capture.marker={side: 3}", "unit missing"),
    ],
)
def test_override_errors_name_the_option(sample, override, words):
    (error,) = errors_of(sample, [override])
    assert words in str(error)
    assert str(error).startswith(f"--set {override}: ")
    assert error.place.line is None


def test_override_errors_come_together(sample):
    assert len(errors_of(sample, ["virtual.buny.mesh=a", "seed"])) == 2
    assert len(errors_of(sample, ["seed=-1", "output.dtype=full"])) == 2


def test_round_trips(sample):
    job = parse_job(sample, FILE)
    again = pickle.loads(pickle.dumps(job))
    assert again == job and again.file == FILE and again.place("seed") == job.place("seed")


def test_confine(sample, tmp_path):
    inside = tmp_path / "inside"
    inside.mkdir()
    (tmp_path / "outside").mkdir()
    (inside / "desk.yaml").write_text(sample, encoding="utf-8")
    load_job(inside / "desk.yaml", confine=inside)
    for wrong in ("../outside/b.ply", str(tmp_path / "x.ply")):
        with pytest.raises(JobErrors, match="leads out of"):
            load_job(inside / "desk.yaml", [f"virtual.bunny.mesh={wrong}"], confine=inside)
    with pytest.raises(JobErrors, match=r"output\.directory"):
        load_job(inside / "desk.yaml", ["output.directory=.."], confine=inside)
    try:
        (inside / "link").symlink_to(tmp_path / "outside", target_is_directory=True)
    except OSError:
        pytest.skip("no symbolic links here")
    with pytest.raises(JobErrors, match="leads out of"):
        load_job(inside / "desk.yaml", ["virtual.bunny.mesh=link/b.ply"], confine=inside)


def test_missing_files_are_all_reported_in_place(sample, tmp_path):
    file = tmp_path / "desk.yaml"
    file.write_text(sample, encoding="utf-8")
    job = load_job(file)
    with pytest.raises(JobErrors) as caught:
        check_files(job)
    words = ["desk.mp4", "env.exr", "paper.png", "bunny.ply"]
    assert [at(e) for e in caught.value.errors] == [position(sample, word) for word in words]
    for word in words:
        (tmp_path / word).touch()
    check_files(job)
    (tmp_path / "bunny.ply").rename(tmp_path / "buny.ply")
    with pytest.raises(JobErrors, match="did you mean `buny.ply`"):
        check_files(job)


@pytest.mark.parametrize("pattern", ["shot_####.png", "shot_%04d.png", "shot_{frame:04d}.png", "shot_*.png"])
def test_file_patterns_need_one_file(sample, tmp_path, pattern):
    for word in ("env.exr", "paper.png", "bunny.ply", "shot.png"):
        (tmp_path / word).touch()
    (tmp_path / "desk.yaml").write_text(sample, encoding="utf-8")
    job = load_job(tmp_path / "desk.yaml", [f"capture.video='{pattern}'"])
    with pytest.raises(JobErrors, match="there is no file"):
        check_files(job)
    (tmp_path / "shot_0007.png").touch()
    check_files(job)


def test_paths_of_a_job(sample):
    written = [path for _, path, out in job_paths(parse_job(sample, FILE)) if out]
    assert written == [FILE.parent / "out"]


@pytest.mark.parametrize(
    ("content", "words"), [(b"\xff\xfe\x00", "not UTF-8"), (b"a: 1\n" * 300_000, "larger than")]
)
def test_files_that_are_no_jobs(tmp_path, content, words):
    file = tmp_path / "job.yaml"
    with pytest.raises(JobErrors, match="no such job file"):
        load_job(file)
    with pytest.raises(JobErrors, match="is a folder"):
        load_job(tmp_path)
    file.write_bytes(content)
    with pytest.raises(JobErrors, match=words):
        load_job(file)


def test_byte_order_mark_and_crlf(sample, tmp_path):
    file = tmp_path / "job.yaml"
    file.write_bytes(b"\xef\xbb\xbf" + sample.replace("\n", "\r\n").encode())
    assert load_job(file).virtual[1].name == "ball"


WORDS = ["", "~", "[]", "{}", "3", "-1e400", ".inf", "60 mm", "photo", "on", "[[1]]", "{a: 1}", "null"]
WORDS += ["'x y'", "*a", "- "]


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_any_change_of_a_job_gives_a_job_or_errors_with_places(sample, data):
    text = sample
    for _ in range(data.draw(st.integers(1, 3))):
        start = data.draw(st.integers(0, len(text)))
        end = min(len(text), start + data.draw(st.integers(0, 20)))
        text = text[:start] + data.draw(st.sampled_from(WORDS)) + text[end:]
    try:
        parse_job(text, FILE)
    except JobErrors as found:
        for error in found.errors:
            assert error.place.line and error.place.column, error
            assert "Input should" not in str(error) and "validator" not in str(error)


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_any_value_at_any_place_gives_a_job_or_errors(sample, data):
    paths = ["virtual", "virtual.0", "virtual.0.material", "virtual.0.transform.scale", "virtual.1.sphere",
             "real.1.reflectance", "real.0.plane.size", "capture", "capture.gain", "capture.marker", "method",
             "method.name", "participants", "participants.0", "output", "output.layers", "output.pattern",
             "effects", "frames", "environment", "environment.world_from_map", "environment.align",
             "environment.align.directions", "name", "seed"]  # fmt: skip
    override = f"{data.draw(st.sampled_from(paths))}={data.draw(st.sampled_from(WORDS))}"
    try:
        parse_job(sample, FILE, [override])
    except JobErrors as found:
        # Most point at the option; a few at what it leaves without sense, such as an effect's name.
        assert found.errors and all(error.place.file for error in found.errors)


def test_missing_files_are_shown_beside_other_errors(sample, tmp_path):
    """One reading names them all, in the order of the file."""
    file = tmp_path / "desk.yaml"
    text = sample.replace("rows: endpoints", "rows: endpoint").replace("spp: 64", "spp: -1")
    file.write_text(text, encoding="utf-8")
    with pytest.raises(JobErrors) as caught:
        load_job(file, files=True)
    places = [at(e) for e in caught.value.errors]
    assert places == sorted(places)
    words = ["desk.mp4", "env.exr", "paper.png", "bunny.ply"]
    for word in (*words, "endpoint", "-1"):
        assert position(text, word) in places, word
    assert sum("there is no file" in e.message for e in caught.value.errors) == 4
    (tmp_path / "env.exr").write_bytes(b"x")
    with pytest.raises(JobErrors) as caught:
        load_job(file, files=True)
    assert sum("there is no file" in e.message for e in caught.value.errors) == 3
    with pytest.raises(JobErrors) as caught:
        load_job(file)
    assert not any("there is no file" in e.message for e in caught.value.errors)


def test_a_confined_job_with_errors_is_not_told_what_lies_outside(sample, tmp_path):
    inside = tmp_path / "inside"
    inside.mkdir()
    (tmp_path / "there.ply").write_bytes(b"x")
    (inside / "desk.yaml").write_text(sample.replace("spp: 64", "spp: -1"), encoding="utf-8")
    told = []
    for name in ("there", "gone"):
        with pytest.raises(JobErrors) as caught:
            load_job(inside / "desk.yaml", [f"virtual.bunny.mesh=../{name}.ply"], confine=inside, files=True)
        told.append([e.message.replace(name, "") for e in caught.value.errors if "ply" in e.message])
    assert len(told[0]) == 1 and "leads out of" in told[0][0] and told[0] == told[1]


def test_paths_of_plain_data_are_those_of_the_job(sample, tmp_path):
    document = read_document(sample, "x")
    job = parse_job(sample, tmp_path / "desk.yaml")
    wanted = {loc: path for loc, path, written in job_paths(job) if not written}
    assert {loc: tmp_path / path for loc, path in input_paths(document.data)} == wanted and len(wanted) == 4


@pytest.mark.parametrize("data", [None, 3, "x", [], {"capture": "x"}, {"virtual": {"mesh": "a.ply"}}])
def test_paths_of_data_that_are_no_job(data):
    assert list(input_paths(data)) == []
