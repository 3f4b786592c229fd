"""Who may grant and revoke control."""

import math

import pytest

from tests.drivers.px4_peer import (
    SECOND,
    STATION,
    SYSTEM,
    T0,
    command,
    connected,
)


def test_a_configured_ground_station_grants_and_revokes() -> None:
    session = connected()
    (granted,) = session.receive(command(param1=1.0), T0)
    (revoked,) = session.receive(command(param1=0.0), T0 + SECOND)
    assert [(a.t_ns, a.granted, a.source) for a in session.authorisations()] == [
        (T0, True, "ground_station"),
        (T0 + SECOND, False, "ground_station"),
    ]
    assert session.authorisations() == []
    assert granted.name == revoked.name == "COMMAND_ACK"
    assert (granted.fields["command"], granted.fields["result"]) == (31010, 0)
    assert (granted.fields["target_system"], granted.fields["target_component"]) == STATION
    assert (granted.system_id, granted.component_id) == (SYSTEM, 191)


@pytest.mark.parametrize("sender", [(255, 191), (254, 190), (42, 1), (SYSTEM, 1)])
def test_nobody_else_grants(sender: tuple[int, int]) -> None:
    session = connected()
    (reply,) = session.receive(command(sender=sender), T0)
    assert reply.fields["result"] == 2
    assert session.authorisations() == []
    assert session.statistics(T0).denied_authorisations == 1


@pytest.mark.parametrize("param1", [2.0, 0.5, -1.0, math.nan, None, "1"])
def test_a_grant_without_meaning_is_denied(param1: object) -> None:
    session = connected()
    (reply,) = session.receive(command(param1=param1), T0)
    assert reply.fields["result"] == 2
    assert session.authorisations() == []


@pytest.mark.parametrize("target", [(SYSTEM, 1), (SYSTEM, 0), (0, 0), (1, 191)])
def test_a_command_for_somebody_else_is_not_answered(target: tuple[int, int]) -> None:
    session = connected()
    assert session.receive(command(target=target), T0) == []
    assert session.authorisations() == []
    assert session.statistics(T0).wrong_target == 1


def test_a_repeated_grant_is_answered_but_is_no_second_grant() -> None:
    session = connected()
    session.receive(command(confirmation=0), T0)
    (reply,) = session.receive(command(confirmation=1), T0 + SECOND)
    assert reply.fields["result"] == 0
    assert len(session.authorisations()) == 1
    session.receive(command(confirmation=1), T0 + 7 * SECOND)
    assert len(session.authorisations()) == 1


def test_another_command_is_unsupported() -> None:
    (reply,) = connected().receive(command(512), T0)
    assert (reply.fields["command"], reply.fields["result"]) == (512, 3)
