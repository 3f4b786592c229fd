"""Parameters: what is right for a flight without GNSS, and how they are read and written."""

import math
import struct
from collections.abc import Mapping

import pytest

from companion.drivers.px4_param_client import (
    ParameterClient,
    ParameterState,
    ParameterValue,
    float_of,
    value_of,
)
from companion.drivers.px4_params import ParameterNeeds, compare, names, rules, writable
from companion.errors import ProtocolError
from companion.messages import Severity
from tests.drivers.px4_peer import MS, SECOND, SYSTEM, T0, connected, message

NEEDS = ParameterNeeds(
    system_id=SYSTEM, max_speed_mps=2.0, max_climb_mps=1.0, max_descent_mps=0.7, min_odometry_quality=10
)


def right() -> dict[str, ParameterValue | None]:
    return {rule.name: rule.recommended for rule in rules(NEEDS)}


class Autopilot:
    """Answers parameter messages from a table, like PX4: integers by their bytes."""

    def __init__(self, table: Mapping[str, ParameterValue], *, deaf: int = 0, frozen: bool = False) -> None:
        self.table = dict(table)
        self.deaf, self.frozen = deaf, frozen
        self.asked = 0

    def answer(self, name: str, fields: dict[str, object]) -> dict[str, object] | None:
        self.asked += 1
        assert (fields["target_system"], fields["target_component"]) == (SYSTEM, 1)
        parameter = str(fields["param_id"])
        if self.deaf or parameter not in self.table:
            self.deaf = max(0, self.deaf - 1)
            return None
        value = self.table[parameter]
        kind = 6 if isinstance(value, int) else 9
        if name == "PARAM_SET" and not self.frozen and fields["param_type"] == kind:
            value = self.table[parameter] = value_of(float(str(fields["param_value"])), kind)
        return {
            "param_id": parameter,
            "param_value": float_of(value),
            "param_type": kind,
            "param_count": 900,
            "param_index": 1,
        }


def converse(client: ParameterClient, autopilot: Autopilot, *, seconds: int = 60) -> None:
    for step in range(seconds * 20):
        t = T0 + step * 50 * MS
        for name, fields in client.poll(t):
            answer = autopilot.answer(name, fields)
            if answer is not None:
                client.receive(message("PARAM_VALUE", **answer), t)
        if client.done:
            return
    raise AssertionError("the conversation did not end")


def test_the_recommended_values_are_right() -> None:
    assert compare(right(), NEEDS) == []


@pytest.mark.parametrize("rule", rules(NEEDS), ids=lambda rule: rule.name)
def test_every_parameter_can_be_wrong_and_missing(rule: object) -> None:
    name = rule.name  # type: ignore[attr-defined]
    wrong: ParameterValue = 4 if name == "COM_RCL_EXCEPT" else 77_000_000
    if name in ("SDLOG_PROFILE", "MPC_XY_VEL_MAX", "MPC_Z_VEL_MAX_UP", "MPC_Z_VEL_MAX_DN"):
        wrong = 0
    (finding,) = compare({**right(), name: wrong}, NEEDS)
    assert (finding.name, finding.found) == (name, wrong)
    assert finding.sentence.startswith(f"{name} is ")
    missing = compare({**right(), name: None}, NEEDS)
    assert len(missing) == (0 if rule.optional else 1)  # type: ignore[attr-defined]


def test_px4s_defaults_are_found_wanting_where_they_would_crash_indoors() -> None:
    defaults = {**right(), "COM_OBL_RC_ACT": 0, "NAV_RCL_ACT": 2, "EKF2_GPS_CTRL": 7, "EKF2_EV_CTRL": 0}
    findings = compare(defaults, NEEDS)
    assert [finding.name for finding in findings] == [
        "EKF2_GPS_CTRL",
        "EKF2_EV_CTRL",
        "COM_OBL_RC_ACT",
        "NAV_RCL_ACT",
    ]
    assert findings[0].severity is Severity.ERROR
    assert findings[-1].severity is Severity.WARNING
    assert writable(findings) == {
        "EKF2_GPS_CTRL": 0,
        "EKF2_EV_CTRL": 15,
        "COM_OBL_RC_ACT": 4,
        "NAV_RCL_ACT": 3,
    }


def test_external_vision_without_velocity_is_right_too() -> None:
    assert compare({**right(), "EKF2_EV_CTRL": 11}, NEEDS) == []


def test_older_firmware_names_the_stick_override_differently() -> None:
    older = {**right(), "MAN_OVERRIDE_SPD": None, "COM_RC_OVERRIDE": 3}
    assert compare(older, NEEDS) == []
    (finding,) = compare({**older, "COM_RC_OVERRIDE": 1}, NEEDS)
    assert finding.name == "COM_RC_OVERRIDE"
    assert "COM_RC_OVERRIDE" in names(NEEDS)


def test_names_fit_the_wire_and_are_unique() -> None:
    listed = names(NEEDS)
    assert len(set(listed)) == len(listed)
    assert all(0 < len(name) <= 16 for name in listed)


@pytest.mark.parametrize("value", [0, 1, 15, 899, 1_000_000, -(2**31), 1.0, 0.1, -3.5])
def test_a_value_survives_its_carrier(value: ParameterValue) -> None:
    kind = 6 if isinstance(value, int) else 9
    carrier = struct.unpack("<f", struct.pack("<f", float_of(value)))[0]
    assert value_of(carrier, kind) == pytest.approx(value)


def test_an_integer_travels_as_bytes() -> None:
    assert float_of(1) == pytest.approx(1.4e-45, rel=0.01)


@pytest.mark.parametrize("value", [-1, 2**31, math.nan, math.inf])
def test_what_cannot_be_carried_is_refused(value: ParameterValue) -> None:
    with pytest.raises(ValueError, match=r"."):
        float_of(value)


@pytest.mark.parametrize(("carrier", "kind"), [(math.nan, 6), (1.0, 5), (1e39, 6), (math.inf, 9)])
def test_an_unreadable_value_is_refused(carrier: float, kind: int) -> None:
    with pytest.raises(ProtocolError):
        value_of(carrier, kind)


def test_parameters_are_read_a_few_at_a_time() -> None:
    client = ParameterClient(SYSTEM)
    table = {name: value for name, value in right().items() if value is not None}
    client.read(table)
    assert len(client.poll(T0)) == 4
    converse(client, Autopilot(table))
    assert compare(client.values(), NEEDS) == []
    assert {entry.state for entry in client.entries.values()} == {ParameterState.READ}


def test_a_parameter_that_nobody_answers_for_is_missing_after_four_tries() -> None:
    client, autopilot = ParameterClient(SYSTEM), Autopilot({})
    client.read(["COM_RC_OVERRIDE"])
    converse(client, autopilot)
    assert autopilot.asked == 4
    assert client.entries["COM_RC_OVERRIDE"].state is ParameterState.MISSING
    assert client.values() == {}


def test_lost_answers_are_asked_for_again() -> None:
    client = ParameterClient(SYSTEM)
    client.read(["COM_OF_LOSS_T"])
    converse(client, Autopilot({"COM_OF_LOSS_T": 1.0}, deaf=3))
    assert client.values() == {"COM_OF_LOSS_T": 1.0}


def test_a_written_value_counts_when_it_is_read_back() -> None:
    client, autopilot = ParameterClient(SYSTEM), Autopilot({"COM_OBL_RC_ACT": 0, "COM_OF_LOSS_T": 2.0})
    client.write({"COM_OBL_RC_ACT": 4, "COM_OF_LOSS_T": 1.0})
    converse(client, autopilot)
    assert autopilot.table == {"COM_OBL_RC_ACT": 4, "COM_OF_LOSS_T": 1.0}
    assert autopilot.asked == 4  # one write and one reading back for each
    assert {entry.state for entry in client.entries.values()} == {ParameterState.WRITTEN}


@pytest.mark.parametrize(
    ("autopilot", "wanted"),
    [(Autopilot({"EKF2_EV_CTRL": 0}, frozen=True), 15), (Autopilot({"EKF2_EV_CTRL": 0}), 15.0)],
)
def test_a_value_that_did_not_stick_is_told(autopilot: Autopilot, wanted: ParameterValue) -> None:
    client = ParameterClient(SYSTEM)
    client.write({"EKF2_EV_CTRL": wanted})
    converse(client, autopilot)
    assert client.entries["EKF2_EV_CTRL"].state is ParameterState.NOT_APPLIED
    assert client.values() == {"EKF2_EV_CTRL": 0}


def test_nothing_is_written_unless_asked() -> None:
    client = ParameterClient(SYSTEM)
    client.read(names(NEEDS))
    sent = [name for step in range(400) for name, _ in client.poll(T0 + step * 50 * MS)]
    assert set(sent) == {"PARAM_REQUEST_READ"}


def test_parameters_go_by_way_of_the_session() -> None:
    session = connected()
    session.parameters.read(["COM_OF_LOSS_T"])
    (asked,) = [m for m in session.poll(T0 + SECOND, None) if m.name == "PARAM_REQUEST_READ"]
    assert asked.fields["param_id"] == "COM_OF_LOSS_T"
    value = message("PARAM_VALUE", param_id="COM_OF_LOSS_T", param_value=1.0, param_type=9)
    session.receive(value, T0 + SECOND)
    assert session.parameters.values() == {"COM_OF_LOSS_T": 1.0}
    assert session.parameters.done


@pytest.mark.parametrize(
    "fields",
    [
        {},
        {"param_id": "COM_OF_LOSS_T"},
        {"param_id": "COM_OF_LOSS_T", "param_value": "1", "param_type": 9},
        {"param_id": "COM_OF_LOSS_T", "param_value": math.nan, "param_type": 9},
        {"param_id": "COM_OF_LOSS_T", "param_value": 1.0, "param_type": 1},
        {"param_id": "X" * 17, "param_value": 1.0, "param_type": 9},
    ],
)
def test_a_bad_value_is_counted_and_the_question_stays_open(fields: dict[str, object]) -> None:
    session = connected()
    session.parameters.read(["COM_OF_LOSS_T"])
    session.receive(message("PARAM_VALUE", **fields), T0)
    assert not session.parameters.done
    assert session.statistics(T0).malformed == 1
