"""The few errors that cross module borders.

Expected outcomes (no path, not converged, no neighbour) are statuses in results, never exceptions.
"""


class CompanionError(Exception):
    """Root of every error raised on purpose; its text is one clear sentence for the operator."""


class ProfileError(CompanionError):
    """A YAML profile or scenario is wrong; the text is ``file:line:column: key: what, what is allowed``."""


class ProtocolError(CompanionError):
    """The peer sent bytes that the protocol forbids."""


class StartError(CompanionError):
    """A driver could not start; the text names the stage that failed."""


class ModelError(CompanionError):
    """A learned model cannot fly; the text names the file, what was found and what is wanted."""


class LogError(CompanionError):
    """A log cannot be written or read."""
