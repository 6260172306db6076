"""Errors that this project raises for bad input; anything else that escapes is a bug."""


class DvcError(Exception):
    """Base of all errors that a user can cause; commands print it as one line and exit with status 2."""


class VideoError(DvcError):
    """A video that cannot be read or written."""


class ConfigError(DvcError):
    """A configuration or combination of options that makes no sense."""


class BitstreamError(DvcError):
    """A damaged, cut, foreign or hostile stream; says which record and offset."""


class FeedbackError(DvcError):
    """A peer that breaks the feedback protocol, falls silent or goes away."""


class PeerClosedError(FeedbackError):
    """The other side of the feedback channel closed the connection."""


class NobodyListensError(FeedbackError):
    """No program of the other side is at an address."""


class UntrustedError(FeedbackError):
    """The other side of the feedback channel is not the program, or not the one, that it should be."""


class RefusedError(FeedbackError):
    """The other side of the feedback channel has reported why it ends."""


class SupersededError(FeedbackError):
    """Another decoder has come, while the one before was away."""


class PartialOutputError(DvcError):
    """A live run that ended early; frames decoded before are kept under other names."""


class RdCurveError(DvcError):
    """Rate-distortion curves that cannot be compared."""
