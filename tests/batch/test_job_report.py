"""The report of a job: of all that is in its folder, whoever rendered it, with times that add up."""

from __future__ import annotations

import json
import threading
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from small_job import write_job

from mrbatch import cli
from mrbatch.batch import events as tell
from mrbatch.batch import job_run
from mrbatch.batch.job_run import render_job
from mrbatch.errors import InputError, ResourceError
from mrbatch.job import load_job
from mrbatch.report.model import Report, TimingNode, load_report

PREVIEWS = ["output.preview.contact_sheet=true", "output.preview.video=true"]


def render(path: Path, *overrides: str, **options: Any):
    return render_job(load_job(path, [*PREVIEWS, *overrides]), **options)


def contents(folder: Path) -> dict[str, tuple[bytes, int]]:
    """Bytes and time stamp of what a person opens."""
    names = ("report.json", "report.html", "preview.mp4", "contact_sheet.png")
    return {name: ((folder / name).read_bytes(), (folder / name).stat().st_mtime_ns) for name in names}


def spoil(picture: Path) -> None:
    picture.write_bytes(picture.read_bytes()[:200])


def frames_of_movie(path: Path) -> int:
    import av

    with av.open(str(path)) as container:
        return sum(1 for _ in container.decode(video=0))


def test_a_run_that_changes_nothing_changes_no_report(tmp_path):
    path = write_job(tmp_path, (0, 1, 2))
    first = render(path)
    assert first.report is not None and first.report.totals.frames_done == 3
    before = contents(tmp_path / "out")
    again = render(path)
    assert again.result.kept == (0, 1, 2)
    assert again.report == first.report
    render(path, "frames=1")
    assert contents(tmp_path / "out") == before


def test_runs_in_one_folder_make_one_report(tmp_path):
    path = write_job(tmp_path, (0, 1, 2, 3))
    render(path, "frames=0-1")
    assert frames_of_movie(tmp_path / "out" / "preview.mp4") == 2
    render(path, "frames=2-3")
    report = load_report(tmp_path / "out")
    assert [(f.number, f.state) for f in report.frames] == [(n, "done") for n in range(4)]
    assert all(f.seconds is not None and f.seconds.value > 0 and f.counters for f in report.frames)
    assert [run.frames for run in report.runs] == [2, 2]
    assert frames_of_movie(tmp_path / "out" / "preview.mp4") == 4
    assert next(p for p in report.pictures if p.role == "sheet").caption == "4 frames"
    totals = report.totals
    assert totals.frame_seconds.value == pytest.approx(sum(f.seconds.value for f in report.frames))
    assert totals.seconds.value == pytest.approx(sum(run.seconds.value for run in report.runs))
    for name, count in totals.counters.items():
        assert count == sum(f.counters[name] for f in report.frames)


def check_sums(node: TimingNode) -> None:
    """No node is shorter than its children together (to rounding)."""
    assert node.seconds >= sum(child.seconds for child in node.children) * (1 - 1e-9)
    for child in node.children:
        check_sums(child)


def test_times_add_up(tmp_path):
    path = write_job(tmp_path, (0, 1, 2))
    told: list[tell.Event] = []
    outcome = render(path, "frames=0", events=told.append)
    done = told[-1]
    assert isinstance(done, tell.Done)
    for _ in range(2):
        report = outcome.report
        check_sums(report.timing)
        names = {child.name for child in report.timing.children}
        assert {"start", "prepare", "previews", "frames", "write frames"} <= names
        outcome = render(path)
    # What is said at the end includes what came before and after the frames.
    first = next(run for run in report.runs if run.frames == 1)
    assert done.seconds >= first.seconds.value >= done.frame_seconds > 0


def test_frames_of_a_killed_run_count_with_what_they_took(tmp_path):
    """It left no line of its own; the times still add up."""
    path = write_job(tmp_path, (0, 1))
    render(path, "frames=0")
    (journal,) = (tmp_path / "out" / "journal").iterdir()
    lines = journal.read_text().splitlines()
    assert json.loads(lines[-1])["kind"] == "run"
    journal.write_text("\n".join(lines[:-1]) + "\n")
    report = render(path).report
    assert [f.state for f in report.frames] == ["done", "done"] and len(report.runs) == 1
    check_sums(report.timing)


def test_a_frame_that_is_gone_leaves_the_report(tmp_path):
    path = write_job(tmp_path, (0, 1))
    render(path)
    (tmp_path / "out" / "small.0001.exr").unlink()
    result = CliRunner().invoke(cli.main, ["report", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    assert [f.number for f in load_report(tmp_path / "out").frames] == [0]


def test_the_command_draws_what_runs_without_report_left(tmp_path):
    path = write_job(tmp_path, (0, 1, 2))
    render(path, "frames=0")
    render(path, "frames=1-2", report=False)
    assert len(load_report(tmp_path / "out").frames) == 1
    result = CliRunner().invoke(cli.main, ["report", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    report = load_report(tmp_path / "out")
    assert [f.number for f in report.frames] == [0, 1, 2]
    assert report.plan.effects and all(effect.meaning for effect in report.plan.effects)


@pytest.mark.parametrize(
    "damage",
    [
        {"settings": 7},
        {"settings": []},
        {"inputs": 3},
        {"inputs": [1]},
        {"layers": 4},
        {"seed": "x"},
        {"key": []},
    ],
)
def test_damaged_records_are_an_input_error_or_passed_over(tmp_path, damage):
    path = write_job(tmp_path, (0,))
    render(path)
    record = json.loads((tmp_path / "out" / "job.json").read_text())
    (tmp_path / "out" / "job.json").write_text(json.dumps(record | damage))
    result = CliRunner().invoke(cli.main, ["report", str(tmp_path / "out")])
    assert result.exit_code in (0, 3), result.output
    again = CliRunner().invoke(cli.main, ["render", str(path), "--progress", "none", "--seed", "5"])
    assert again.exit_code == 2 and "another job" in again.stderr


# --- what failed -------------------------------------------------------------------------------------


def states(report: Report) -> list[str]:
    return [frame.state for frame in report.frames]


def test_a_run_that_stopped_says_where_and_what_was_not_tried(tmp_path):
    path = write_job(tmp_path, (0, 1, 2, 3))
    whole = (tmp_path / "photo_0001.png").read_bytes()
    spoil(tmp_path / "photo_0001.png")
    told: list[tell.Event] = []
    outcome = render(path, events=told.append)
    assert outcome.exit_code == 4
    assert any(isinstance(e, tell.Note) and "2 frames were not tried" in e.message for e in told)
    report = outcome.report
    assert states(report) == ["done", "failed", "skipped", "skipped"]
    message = report.frames[1].message
    assert message.startswith("photo_0001.png: ") and "damaged or cut short" in message
    assert report.frames[1].hint
    assert report.frames[2].message == "not tried: the run stopped at frame 1"
    assert report.exit == 4
    (tmp_path / "photo_0001.png").write_bytes(whole)
    # Other content is another job: the folder has to be taken.
    report = render(path, overwrite=True).report
    assert states(report) == ["done"] * 4 and report.exit == 0


@pytest.mark.case("IO-08")
def test_missing_numbers_and_lost_frames_are_failed_frames(tmp_path):
    path = write_job(tmp_path, (0, 1, 3, 4))
    content = json.loads(path.read_text())
    poses = json.loads((tmp_path / "poses.json").read_text())
    (tmp_path / "poses.json").write_text(json.dumps([p for p in poses if p["frame"] != 4]))
    content["capture"]["lost"] = "skip"
    path.write_text(json.dumps(content))
    told: list[tell.Event] = []
    outcome = render(path, events=told.append)
    assert outcome.exit_code == 4
    report = outcome.report
    assert [(f.number, f.state) for f in report.frames] == [
        (0, "done"), (1, "done"), (2, "failed"), (3, "done"), (4, "failed"),
    ]  # fmt: skip
    assert "no such frame" in report.frames[2].message and "no camera pose" in report.frames[4].message
    notes = [event.message for event in told if isinstance(event, tell.Note)]
    assert "missing in the footage: 1 frame (2)" in notes
    assert "without a pose, so left out: 1 frame (4)" in notes
    assert render(path).report == report
    assert render(path, "frames=2").exit_code == 3
    assert render(path, "frames=0-1").exit_code == 0


def test_a_missing_number_is_held(tmp_path):
    path = write_job(tmp_path, (0, 1, 3), on_error="hold-last")
    outcome = render(path)
    assert outcome.exit_code == 4
    assert states(outcome.report) == ["done", "done", "failed", "done"]
    assert outcome.report.frames[2].flags == ("shows frame 1",)
    assert (tmp_path / "out" / "small.0002.exr").is_file()
    assert frames_of_movie(tmp_path / "out" / "preview.mp4") == 4


def test_stand_ins_stay_while_nothing_changes(tmp_path):
    path = write_job(tmp_path, (0, 1, 3), on_error="hold-last")
    first = render(path)
    before = contents(tmp_path / "out"), (tmp_path / "out" / "small.0002.exr").stat().st_mtime_ns
    again = render(path)
    assert again.exit_code == 4 and again.result.failed[0].held_from == 1
    assert (contents(tmp_path / "out"), (tmp_path / "out" / "small.0002.exr").stat().st_mtime_ns) == before
    assert again.report == first.report


def test_whoever_ends_last_leaves_previews_of_all_frames(tmp_path, monkeypatch):
    """Another process finishes a frame while the previews are made."""
    path = write_job(tmp_path, (0, 1, 2))
    make = job_run.make_previews
    calls = []

    def meanwhile(*given: Any, **options: Any):
        made = make(*given, **options)
        calls.append(len(given[2]))
        if len(calls) == 1:
            render(path, "frames=2", report=False)
        return made

    monkeypatch.setattr(job_run, "make_previews", meanwhile)
    report = render(path, "frames=0-1").report
    assert calls == [2, 3]
    assert frames_of_movie(tmp_path / "out" / "preview.mp4") == 3
    assert states(report) == ["done"] * 3


def test_a_run_that_ended_early_says_why(tmp_path, monkeypatch):
    path = write_job(tmp_path, (0, 1))
    shot_render = job_run.ShotRenderer.render

    def refuse(self, number, history):
        if number == 1:
            raise ResourceError("the disk is gone", hint="plug it in")
        return shot_render(self, number, history)

    monkeypatch.setattr(job_run.ShotRenderer, "render", refuse)
    told: list[tell.Event] = []
    outcome = render(path, events=told.append)
    assert outcome.exit_code == 5
    report = outcome.report
    assert states(report) == ["done", "skipped"] and report.exit == 5
    (note,) = [note for note in report.notes if note.level == "error"]
    assert "the disk is gone" in note.text and "plug it in" in note.text
    assert report.runs[0].message == "the run ended: the disk is gone"
    page = (tmp_path / "out" / "report.html").read_text()
    assert "the disk is gone" in page
    monkeypatch.setattr(job_run.ShotRenderer, "render", shot_render)
    report = render(path).report
    assert states(report) == ["done", "done"] and report.exit == 0
    assert not [note for note in report.notes if note.level == "error"]


def test_an_interrupted_run_says_how_to_go_on(tmp_path):
    path = write_job(tmp_path, (0, 1, 2))
    stop = threading.Event()
    told: list[tell.Event] = []

    def sink(event: tell.Event) -> None:
        told.append(event)
        if isinstance(event, tell.FrameDone):
            stop.set()

    outcome = render(path, events=sink, stop=stop)
    assert outcome.exit_code == 130 and outcome.report.exit == 130
    done = told[-1]
    assert isinstance(done, tell.Done)
    assert done.message == "interrupted: the same command goes on; 1 of 3 frames are there"
    assert states(outcome.report) == ["done", "skipped", "skipped"]
    assert not (tmp_path / "out" / "preview.mp4").exists()
    assert render(path).report.exit == 0


def test_a_report_that_cannot_be_written_costs_no_frame(tmp_path, monkeypatch):
    path = write_job(tmp_path, (0,))

    def refuse(*_: object) -> None:
        raise ResourceError("no room for the report")

    monkeypatch.setattr(job_run, "save_report", refuse)
    told: list[tell.Event] = []
    outcome = render(path, events=told.append)
    assert outcome.exit_code == 5 and outcome.result.rendered == (0,)
    assert isinstance(told[-1], tell.Done) and told[-1].exit_code == 5


def test_input_errors_of_the_whole_job_are_raised(tmp_path):
    path = write_job(tmp_path, (0, 1))
    (tmp_path / "sky.exr").write_bytes(b"rubbish")
    with pytest.raises(InputError, match=r"sky\.exr"):
        render(path)
