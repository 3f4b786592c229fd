"""What the link to the autopilot counts."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class LinkStatistics:
    """Counts since the session began.

    Attributes:
        received: messages by name, from the configured autopilot.
        foreign: messages of other vehicles, by system id.
        malformed: messages with a field missing, out of range or not a number.
        wrong_target: commands addressed to somebody else.
        denied_authorisations: grants from somebody who may not give them, or without meaning.
        refused: what was not sent and why, for example ``setpoint stale``.
        sent: setpoints, odometry and texts handed out.
        commands_denied, commands_timed_out: commands refused, and never answered.
        unmatched_timesync: clock answers to questions never asked, or too late.
        reboots: how often the autopilot has started anew.
        round_trip_ns, clock_offset_ns: of the clock comparison in use; None while unknown.
        suspect: heartbeats of our autopilot come faster than one autopilot sends them.
    """

    received: dict[str, int]
    foreign: dict[int, int]
    malformed: int
    wrong_target: int
    denied_authorisations: int
    refused: dict[str, int]
    sent: dict[str, int]
    commands_denied: int
    commands_timed_out: int
    unmatched_timesync: int
    reboots: int
    round_trip_ns: int | None
    clock_offset_ns: int | None
    suspect: bool
