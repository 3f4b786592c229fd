"""The PX4 parameters that a flight without GNSS needs, why, and how a vehicle's differ.

Names and values are those of PX4 1.18; measured means flown in its simulator with external vision in
MAV_FRAME_LOCAL_FRD. Checking never writes: `recommended` is for an operator who asks for it.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from companion.drivers.px4_param_client import ParameterValue, same
from companion.messages import Severity


@dataclass(frozen=True, slots=True)
class ParameterRule:
    """What one parameter must be.

    Attributes:
        name: PX4's name.
        recommended: the value to write; an `int` for an integer parameter.
        why: one clause that completes "because".
        allowed: values that are right; empty if a range or bits decide.
        low, high: limits that are right.
        bits: bits that must be set.
        severity: ERROR forbids the flight, WARNING does not.
        older: the rule for firmware that has another parameter instead.
        optional: firmware without it is right as well.
    """

    name: str
    recommended: ParameterValue
    why: str
    allowed: tuple[ParameterValue, ...] = ()
    low: float = -math.inf
    high: float = math.inf
    bits: int = 0
    severity: Severity = Severity.ERROR
    older: "ParameterRule | None" = None
    optional: bool = False

    def accepts(self, value: ParameterValue) -> bool:
        """Tell whether a value is right."""
        if self.allowed and not any(same(value, allowed) for allowed in self.allowed):
            return False
        if self.bits and int(value) & self.bits != self.bits:
            return False
        return self.low <= value <= self.high

    @property
    def wanted(self) -> str:
        """What is right, in words."""
        if self.allowed:
            return " or ".join(f"{value:g}" for value in self.allowed)
        if self.bits:
            return f"bits {self.bits} set"
        if self.low == -math.inf:
            return f"at most {self.high:g}"
        if self.high == math.inf:
            return f"at least {self.low:g}"
        return f"from {self.low:g} to {self.high:g}"


@dataclass(frozen=True, slots=True)
class ParameterNeeds:
    """What a vehicle's profile demands of the parameters.

    Attributes:
        system_id: MAV_SYS_ID.
        max_speed_mps, max_climb_mps, max_descent_mps: the largest velocities ever commanded.
        min_odometry_quality: the lowest quality that is sent.
    """

    system_id: int = 1
    max_speed_mps: float = 0.0
    max_climb_mps: float = 0.0
    max_descent_mps: float = 0.0
    min_odometry_quality: int = 1


@dataclass(frozen=True, slots=True)
class ParameterFinding:
    """One parameter that is not right.

    Attributes:
        name: the parameter.
        found: its value, or None if the autopilot does not have it.
        wanted: what is right, in words.
        why: the reason.
        severity: ERROR forbids the flight, WARNING does not.
        recommended: the value to write.
    """

    name: str
    found: ParameterValue | None
    wanted: str
    why: str
    severity: Severity
    recommended: ParameterValue = field(compare=False)

    @property
    def sentence(self) -> str:
        """One line for the operator."""
        found = "is missing" if self.found is None else f"is {self.found:g}"
        return f"{self.name} {found}, wanted {self.wanted}, because {self.why}"


_W = Severity.WARNING

_FIXED: tuple[ParameterRule, ...] = (
    ParameterRule("EKF2_GPS_CTRL", 0, "GNSS is not to be fused", allowed=(0,)),
    ParameterRule(
        "EKF2_EV_CTRL", 15, "position and yaw come from external vision (11 is without velocity)", (11, 15)
    ),
    ParameterRule("EKF2_HGT_REF", 3, "height comes from external vision", allowed=(3,)),
    ParameterRule("SYS_HAS_GPS", 0, "arming must not wait for a receiver", allowed=(0,)),
    ParameterRule("EKF2_EV_NOISE_MD", 0, "the covariances that we send are to be used", allowed=(0,)),
    ParameterRule(
        "EKF2_EV_DELAY", 0.0, "odometry carries its sample time, so only a small rest remains", high=50.0
    ),
    ParameterRule("EKF2_EV_POS_X", 0.0, "odometry is of the body origin", low=-0.02, high=0.02),
    ParameterRule("EKF2_EV_POS_Y", 0.0, "odometry is of the body origin", low=-0.02, high=0.02),
    ParameterRule("EKF2_EV_POS_Z", 0.0, "odometry is of the body origin", low=-0.02, high=0.02),
    ParameterRule(
        "EKF2_MAG_TYPE", 5, "only none (5) and automatic (0) were flown with vision yaw", (0, 5), severity=_W
    ),
    ParameterRule(
        "EKF2_NOAID_TOUT",
        1_000_000,
        "flying on inertia alone is 3.5 m off after 5 s",
        high=5_000_000,
        severity=_W,
    ),
    ParameterRule(
        "COM_OBL_RC_ACT", 4, "without GNSS only landing is possible when setpoints end", allowed=(4,)
    ),
    ParameterRule(
        "COM_OF_LOSS_T", 1.0, "a companion that is gone must be noticed within a second", low=0.2, high=1.0
    ),
    ParameterRule(
        "COM_RCL_EXCEPT",
        0,
        "with bit 4 set, losing the pilot's radio in OFFBOARD changes nothing",
        (0, 1, 2, 3),
        severity=_W,
    ),
    ParameterRule(
        "NAV_RCL_ACT", 3, "hold and return need a global position; landing does not", (3,), severity=_W
    ),
    ParameterRule("NAV_DLL_ACT", 0, "hold and return need a global position", (0, 3), severity=_W),
    ParameterRule("COM_LOW_BAT_ACT", 2, "return needs a global position; landing does not", (0, 2)),
    ParameterRule(
        "GF_ACTION", 1, "hold and return need a global position; warn or land instead", (0, 1, 5), severity=_W
    ),
    ParameterRule(
        "MAN_OVERRIDE_SPD",
        1.0,
        "moving the sticks must take the vehicle back",
        low=0.01,
        high=5.0,
        older=ParameterRule("COM_RC_OVERRIDE", 3, "moving the sticks must take the vehicle back", bits=2),
    ),
    ParameterRule("MAV_FWDEXTSP", 1, "velocity setpoints arrive by MAVLink", allowed=(1,)),
    ParameterRule(
        "SYS_FAILURE_EN", 0, "failure injection has no place in the field", allowed=(0,), optional=True
    ),
    ParameterRule(
        "SDLOG_PROFILE", 129, "vision (bit 7) must be in the autopilot's log", bits=128, severity=_W
    ),
)


def rules(needs: ParameterNeeds) -> tuple[ParameterRule, ...]:
    """Return every rule for a vehicle with these needs."""
    speed, climb, descent = needs.max_speed_mps, needs.max_climb_mps, needs.max_descent_mps
    return (
        *_FIXED,
        ParameterRule(
            "MAV_SYS_ID", needs.system_id, "the profile names this vehicle", allowed=(needs.system_id,)
        ),
        ParameterRule(
            "EKF2_EV_QMIN",
            0,
            "odometry that we find good enough must be fused",
            high=needs.min_odometry_quality,
        ),
        ParameterRule("MPC_XY_VEL_MAX", max(speed, 2.0), "the profile commands that speed", low=speed),
        ParameterRule("MPC_Z_VEL_MAX_UP", max(climb, 1.0), "the profile commands that climb", low=climb),
        ParameterRule(
            "MPC_Z_VEL_MAX_DN", max(descent, 1.0), "the profile commands that descent", low=descent
        ),
    )


def names(needs: ParameterNeeds) -> tuple[str, ...]:
    """Return the names of every parameter to read, those of older firmware included."""
    listed: list[str] = []
    for rule in rules(needs):
        listed.append(rule.name)
        if rule.older is not None:
            listed.append(rule.older.name)
    return tuple(listed)


def compare(
    values: Mapping[str, ParameterValue | None], needs: ParameterNeeds | None = None
) -> list[ParameterFinding]:
    """Return what is not right, errors before warnings.

    Args:
        values: as read; missing or None for a parameter that the autopilot does not have.
        needs: the profile's demands.
    """
    findings: list[ParameterFinding] = []
    for listed in rules(needs or ParameterNeeds()):
        rule = listed
        if (
            values.get(rule.name) is None
            and rule.older is not None
            and values.get(rule.older.name) is not None
        ):
            rule = rule.older
        found = values.get(rule.name)
        if found is None and rule.optional:
            continue
        if found is None or not rule.accepts(found):
            findings.append(
                ParameterFinding(rule.name, found, rule.wanted, rule.why, rule.severity, rule.recommended)
            )
    return sorted(findings, key=lambda finding: finding.severity)


def writable(findings: Sequence[ParameterFinding]) -> dict[str, ParameterValue]:
    """Return what to write to put the findings right; parameters that do not exist cannot be."""
    return {finding.name: finding.recommended for finding in findings if finding.found is not None}
