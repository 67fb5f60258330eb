"""Which methods and participants there are. Adding one takes its folder and one line here."""

from __future__ import annotations

from mrbatch.capture.registry import Registry
from mrbatch.contracts import Method, Participant

METHODS: Registry[Method] = Registry(
    "method",
    {
        "image-based-lighting": "mrbatch.methods.image_based_lighting:METHOD",
        "delta-path-tracing": "mrbatch.methods.delta_path_tracing:METHOD",
        "two-pass": "mrbatch.methods.two_pass:METHOD",
        "one-pass": "mrbatch.methods.one_pass:METHOD",
    },
)

PARTICIPANTS: Registry[Participant] = Registry("participant", {})


def method(name: str) -> Method:
    """The method of that name. Raises JobError."""
    return METHODS.get(name)


def method_names() -> tuple[str, ...]:
    return METHODS.names()


def participant(name: str) -> Participant:
    """The participant of that name. Raises JobError."""
    return PARTICIPANTS.get(name)


def participant_names() -> tuple[str, ...]:
    return PARTICIPANTS.names()


def register(thing: Method | Participant):
    """Context in which a method or participant can be used by jobs (for tests and experiments)."""
    if isinstance(thing, Participant):
        return PARTICIPANTS.registered(thing.name, thing)
    return METHODS.registered(thing.name, thing)
