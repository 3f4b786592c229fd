"""One sentence for the operator: at which stage the LiDAR failed to start, and what to check."""

from dataclasses import dataclass

from companion.drivers.livox_health import LidarInfo, describe_hms, describe_work_state
from companion.drivers.livox_protocol import DeviceType, ReturnCode, WorkState
from companion.drivers.livox_settings import LivoxSettings
from companion.drivers.livox_stage import Stage

LOADER = 0


@dataclass(frozen=True, slots=True)
class Evidence:
    """What the handshake has seen besides the sensor's own words.

    Attributes:
        attempts: requests of the present stage sent so far.
        refusal: return code and key of the last refused command of this stage.
        other_host: address to which the sensor was found to send instead.
        have_points, have_imu: what arrived since the sensor was last configured.
        rounds_without_data: complete conversations after which not all data came.
        unconfirmed: the stage that got no answer although data flows.
        send_error: why the last datagram could not be sent.
        strangers: address and serial number of other sensors heard.
    """

    attempts: int = 0
    refusal: tuple[int, int] | None = None
    other_host: str = ""
    have_points: bool = False
    have_imu: bool = False
    rounds_without_data: int = 0
    unconfirmed: Stage | None = None
    send_error: str = ""
    strangers: tuple[tuple[str, str], ...] = ()


def describe(stage: Stage, settings: LivoxSettings, host_ip: str, info: LidarInfo, evidence: Evidence) -> str:
    """Return one sentence without a final full stop."""
    lidar_ip, ports = settings.lidar_ip, settings.lidar_ports
    if stage is Stage.STREAMING:
        if evidence.unconfirmed is not None:
            return (
                f"the LiDAR at {lidar_ip} streams, but left the stage {evidence.unconfirmed.value!r} "
                "unanswered"
            )
        return f"the LiDAR at {lidar_ip} streams points and IMU"
    if info.device_type is not None and info.device_type not in list(DeviceType):
        return f"the device at {lidar_ip} has type {info.device_type}, which is not a Mid-360"
    if evidence.rounds_without_data and (stage is Stage.AWAITING_DATA or evidence.attempts < 3):
        return _without_data(settings, host_ip, info, evidence)
    if stage is Stage.SEARCHING:
        return _without_answer(settings, host_ip, evidence)
    if stage is Stage.IDENTIFYING and info.firmware_type == LOADER:
        return f"the LiDAR at {lidar_ip} runs its loader only: its firmware update was not completed"
    if evidence.other_host:
        return (
            f"the LiDAR at {lidar_ip} keeps sending to {evidence.other_host} instead of {host_ip}: "
            "another program configures it too"
        )
    if evidence.refusal is not None:
        return f"the LiDAR at {lidar_ip} refused {_refused(*evidence.refusal)} while {stage.value}"
    if stage is Stage.AWAITING_DATA:
        return _without_data(settings, host_ip, info, evidence)
    return (
        f"the LiDAR at {lidar_ip} was found, but does not answer commands on port {ports.command} "
        f"while {stage.value}: a firewall may block UDP port {settings.host_ports.command} on {host_ip}"
    )


def _without_answer(settings: LivoxSettings, host_ip: str, evidence: Evidence) -> str:
    if evidence.send_error:
        return (
            f"no answer to discovery from {settings.lidar_ip}: sending from {host_ip} failed with "
            f"{evidence.send_error}"
        )
    if evidence.strangers:
        heard = ", ".join(f"{ip} (serial {serial or 'unknown'})" for ip, serial in evidence.strangers)
        return (
            f"no answer to discovery from {settings.lidar_ip}, but a LiDAR was heard at {heard}: "
            "check lidar_ip and that this computer is in the same subnet"
        )
    return (
        f"no answer to discovery from {settings.lidar_ip}: check power, cable, the LiDAR's address "
        f"(192.168.1.1xx with the last two digits of its serial number) and that {host_ip} is in its subnet"
    )


def _without_data(settings: LivoxSettings, host_ip: str, info: LidarInfo, evidence: Evidence) -> str:
    lidar_ip, ports = settings.lidar_ip, settings.host_ports
    if info.work_state not in (None, WorkState.SAMPLING):
        codes = "; ".join(describe_hms(code) for code in info.hms_codes)
        return (
            f"the LiDAR at {lidar_ip} answers, but its working state is "
            f"{describe_work_state(info.work_state)}{': ' + codes if codes else ''}"
        )
    if evidence.have_points:
        what, port = "points arrive, but no IMU data", ports.imu
    elif evidence.have_imu:
        what, port = "IMU data arrives, but no point data", ports.points
    else:
        what, port = "commands are answered, but no point data", ports.points
    return (
        f"{what} arrives from {lidar_ip} on port {port}: a firewall may block UDP ports {ports.state}, "
        f"{ports.points} and {ports.imu} on {host_ip}"
    )


def _refused(return_code: int, key: int) -> str:
    try:
        reason = ReturnCode(return_code).name.lower().replace("_", " ")
    except ValueError:
        reason = "unknown reason"
    return f"parameter 0x{key:04x} ({reason}, return code 0x{return_code:02x})"
