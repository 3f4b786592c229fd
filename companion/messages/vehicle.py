"""The autopilot as it describes itself."""

from dataclasses import dataclass
from enum import Enum

from companion.messages.arrays import FloatArray


class VehicleMode(Enum):
    """Flight mode of the autopilot."""

    UNKNOWN = "unknown"
    MANUAL = "manual"
    STABILIZED = "stabilized"
    ACRO = "acro"
    ALTITUDE = "altitude"
    POSITION = "position"
    OFFBOARD = "offboard"
    TAKEOFF = "takeoff"
    HOLD = "hold"
    MISSION = "mission"
    RETURN = "return"
    LAND = "land"


class LandedState(Enum):
    """Whether the autopilot believes it flies."""

    UNKNOWN = "unknown"
    ON_GROUND = "on_ground"
    IN_AIR = "in_air"
    TAKING_OFF = "taking_off"
    LANDING = "landing"


@dataclass(frozen=True, slots=True, eq=False)
class VehicleState:
    """Latest values received from the autopilot.

    Attributes:
        t_ns: host time of this summary.
        connected: a heartbeat of the configured system arrived within 3 s.
        failsafe: the autopilot reports a critical state.
        t_local_ns: host time of the newest local position or attitude, whichever is older; 0 without one.
        p_map, v_map, q_map_body: the autopilot's own estimate turned into map axes.
        estimator_reset_counter: the autopilot's count of its estimate's jumps.
        mode_changes: number of mode changes seen since connecting.
    """

    t_ns: int
    connected: bool
    armed: bool
    mode: VehicleMode
    landed: LandedState
    failsafe: bool
    t_local_ns: int
    p_map: FloatArray
    v_map: FloatArray
    q_map_body: FloatArray
    estimator_reset_counter: int
    mode_changes: int
