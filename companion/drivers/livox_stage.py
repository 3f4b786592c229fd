"""Stages of the conversation with a Livox sensor."""

from enum import Enum


class Stage(Enum):
    """Where the conversation stands."""

    SEARCHING = "searching"
    IDENTIFYING = "identifying"
    ADDRESSING = "addressing"
    CONFIGURING = "configuring"
    VERIFYING = "verifying"
    AWAITING_DATA = "awaiting data"
    STREAMING = "streaming"
