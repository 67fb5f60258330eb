"""The job: the YAML contract between a person and a run. See docs/job.md."""

from mrbatch.job.files import check_files
from mrbatch.job.frames import select_frames
from mrbatch.job.loader import load_job, parse_job
from mrbatch.job.model import Job
from mrbatch.job.resolve import pixel_relevant, resolved

__all__ = ["Job", "check_files", "load_job", "parse_job", "pixel_relevant", "resolved", "select_frames"]
