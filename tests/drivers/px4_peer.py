"""Messages as a PX4 sends them, for the tests of the session."""

import numpy as np

from companion.drivers.px4_modes import custom_mode_of
from companion.drivers.px4_session import Px4Session
from companion.drivers.px4_settings import GroundStation, Px4Settings
from companion.messages import MavlinkMessage, Odometry, OdometryStatus, Setpoint, VehicleMode

MS = 1_000_000
SECOND = 1_000_000_000
T0 = 100 * SECOND
SYSTEM = 7
STATION = (255, 190)


def settings(**changes: object) -> Px4Settings:
    stations = (GroundStation(system_id=STATION[0], component_id=STATION[1]),)
    values: dict[str, object] = {"system_id": SYSTEM, "ground_stations": stations, **changes}
    return Px4Settings.model_validate(values)


def message(name: str, **fields: object) -> MavlinkMessage:
    return MavlinkMessage(name, SYSTEM, 1, fields)


def heartbeat(
    mode: VehicleMode = VehicleMode.HOLD, *, armed: bool = False, status: int = 3, system_id: int = SYSTEM
) -> MavlinkMessage:
    fields: dict[str, object] = {
        "type": 2,
        "autopilot": 12,
        "base_mode": 0x1D | (0x80 if armed else 0),
        "custom_mode": custom_mode_of(mode),
        "system_status": status,
        "mavlink_version": 3,
    }
    return MavlinkMessage("HEARTBEAT", system_id, 1, fields)


def acknowledgement(command: int, result: int, target: tuple[int, int] = (SYSTEM, 191)) -> MavlinkMessage:
    return message(
        "COMMAND_ACK",
        command=command,
        result=result,
        progress=0,
        result_param2=0,
        target_system=target[0],
        target_component=target[1],
    )


def command(
    number: int = 31010,
    param1: object = 1.0,
    *,
    sender: tuple[int, int] = STATION,
    target: tuple[int, int] = (SYSTEM, 191),
    confirmation: int = 0,
) -> MavlinkMessage:
    fields: dict[str, object] = {
        "target_system": target[0],
        "target_component": target[1],
        "command": number,
        "confirmation": confirmation,
        "param1": param1,
        **{f"param{index}": 0.0 for index in range(2, 8)},
    }
    return MavlinkMessage("COMMAND_LONG", *sender, fields)


def answer_clock(session: Px4Session, t_ns: int, autopilot_ns: int) -> None:
    """Let the session ask for the time at `t_ns` and answer it at once."""
    for sent in session.poll(t_ns, None):
        if sent.name == "TIMESYNC":
            session.receive(message("TIMESYNC", tc1=autopilot_ns, ts1=sent.fields["ts1"]), t_ns)


def connected(t_ns: int = T0, *, autopilot_ns: int = 5 * SECOND, **changes: object) -> Px4Session:
    """Return a session that has heard its autopilot and knows its time."""
    session = Px4Session(settings(**changes))
    session.receive(heartbeat(), t_ns)
    answer_clock(session, t_ns, autopilot_ns)
    return session


def a_setpoint(t_ns: int, v_map: tuple[float, ...] = (1.0, 2.0, 3.0), yaw_rate: float = 0.5) -> Setpoint:
    return Setpoint(t_ns, t_ns, t_ns, np.array(v_map), yaw_rate, "test")


def an_odometry(t_ns: int, **changes: object) -> Odometry:
    values: dict[str, object] = {
        "t_ns": t_ns,
        "t_sensor_ns": t_ns,
        "p_map": np.array([1.0, 2.0, 3.0]),
        "q_map_body": np.array([1.0, 0.0, 0.0, 0.0]),
        "v_map": np.array([0.1, 0.2, 0.3]),
        "omega_body": np.array([0.01, 0.02, 0.03]),
        "covariance_pose": np.diag([1e-4, 2e-4, 3e-4, 4e-6, 5e-6, 6e-6]),
        "covariance_velocity": np.diag([1e-3, 2e-3, 3e-3]),
        "quality": 90,
        "reset_counter": 0,
        "status": OdometryStatus.TRACKING,
        **changes,
    }
    return Odometry(**values)  # type: ignore[arg-type]
