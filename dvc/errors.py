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


class ConnectionLostError(FeedbackError):
    """The connection to the other side of the feedback channel broke; another one may continue the run."""


class NobodyListensError(ConnectionLostError):
    """No program of the other side listens at an address."""


class UntrustedError(FeedbackError):
    """The other side of the feedback channel did not prove its identity."""


class RefusedError(FeedbackError):
    """The other side of the feedback channel ended the run, and gave a reason."""


class PartialOutputError(DvcError):
    """A live run that ended early; frames decoded before are kept under other names."""


class RdCurveError(DvcError):
    """Rate-distortion curves that cannot be compared."""
