"""The inside of the emulated Mid-360: power, working states, and what it says about itself."""

import struct
from typing import Literal

from pydantic import Field

from companion.clock import seconds_to_ns
from companion.drivers.livox_packets import TimeType
from companion.drivers.livox_protocol import Key, Parameters, ReturnCode, StreamAddress, WorkState
from companion.drivers.livox_settings import HostPorts, IPv4, LidarPorts
from companion.settings import Settings
from sitl.livox_parameters import ParameterStore

CORE_TEMPERATURE_C = 52.0
_TARGETS = {"sampling": WorkState.SAMPLING, "idle": WorkState.IDLE, "ready": WorkState.READY}
_PRODUCT_INFO = b"DevType:Mid-360 FmType:App FmVer:35010108 BuildTime:2025/06/09"
_SYSTEM_ERROR = 2


class LivoxEmulatorSettings(Settings):
    """One emulated Livox Mid-360."""

    lidar_ip: IPv4 = "127.0.0.2"
    """Its address; a host drops data from its own address, so they must differ."""
    ports: LidarPorts = LidarPorts()
    """Its UDP ports."""
    serial: str = Field(default="AREMULATED0001", max_length=16, pattern=r"^[A-Z0-9]+$")
    """Serial number."""
    persisted_host_ip: IPv4 | Literal[""] = ""
    """Host to which it streams unasked after power-on; empty for none."""
    persisted_host_ports: HostPorts = HostPorts()
    """Ports of that host."""
    persisted_target: Literal["sampling", "idle", "ready"] = "idle"
    """Working state that it takes by itself after power-on."""
    self_check_s: float = Field(default=0.0, ge=0.0, le=60.0)
    """Duration of the self-check after power-on."""
    motor_start_s: float = Field(default=0.0, ge=0.0, le=60.0)
    """Time from idle to sampling or ready."""
    firmware_type: Literal["application", "loader"] = "application"
    """What runs on it."""


class EmulatedDevice:
    """Parameters and working state of one sensor; knows host time from its arguments only."""

    def __init__(self, settings: LivoxEmulatorSettings, boot_host_ns: int) -> None:
        """Power on at host time `boot_host_ns`."""
        self._settings = settings
        self._parameters = ParameterStore(settings.lidar_ip)
        self._power_ups = 0
        self._hms_code = 0
        self.power_cycle(boot_host_ns)
        self._describe()

    @property
    def boot_host_ns(self) -> int:
        """Host time at which sensor time was 0."""
        return self._boot_ns

    def power_cycle(self, boot_host_ns: int) -> None:
        """Start again at host time `boot_host_ns` with factory and persisted values only."""
        settings, parameters = self._settings, self._parameters
        self._boot_ns = boot_host_ns
        self._checked_ns = boot_host_ns + seconds_to_ns(settings.self_check_s)
        self._motor_ready_ns: int | None = None
        self._power_ups += 1
        parameters.restore_factory_values()
        if settings.persisted_host_ip:
            ip, ports = settings.persisted_host_ip, settings.persisted_host_ports
            parameters[Key.STATE_HOST] = StreamAddress(ip, ports.state).pack()
            parameters[Key.POINT_HOST] = StreamAddress(ip, ports.points).pack()
            parameters[Key.IMU_HOST] = StreamAddress(ip, ports.imu).pack()
        self._set_target(boot_host_ns, _TARGETS[settings.persisted_target])

    def set_fault(self, hms_code: int) -> None:
        """Enter the working state ERROR with a health code, or leave it with 0."""
        self._hms_code = hms_code

    def work_state(self, t_ns: int) -> WorkState:
        """Return the working state at host time `t_ns`."""
        if self._hms_code:
            return WorkState.ERROR
        if t_ns < self._checked_ns:
            return WorkState.SELF_CHECK
        if self._motor_ready_ns is None:
            return WorkState.IDLE
        if t_ns < self._motor_ready_ns:
            return WorkState.MOTOR_STARTUP
        return WorkState(self[Key.WORK_TARGET][0])

    def __getitem__(self, key: int) -> bytes:
        """Return the present value of a parameter that does not change by itself."""
        return self._parameters[key]

    def write(self, t_ns: int, parameters: Parameters) -> tuple[ReturnCode, int]:
        """Store values from the host; return the return code and the first bad key, or 0."""
        targets = [value for key, value in parameters if key == Key.WORK_TARGET]
        if targets and self.work_state(t_ns) is WorkState.ERROR:
            return ReturnCode.NOT_PERMITTED, Key.WORK_TARGET
        code, key = self._parameters.write(parameters)
        if targets and code in (ReturnCode.OK, ReturnCode.NEEDS_REBOOT):
            self._set_target(t_ns, WorkState(targets[-1][0]))
        return code, key

    def read(self, t_ns: int, keys: list[int]) -> list[tuple[int, bytes]]:
        """Return the values at host time `t_ns` of those keys that exist."""
        fault = _SYSTEM_ERROR if self._hms_code else 0
        parameters = self._parameters
        parameters[Key.WORK_STATE] = bytes([self.work_state(t_ns)])
        parameters[Key.LOCAL_TIME] = struct.pack("<Q", max(0, t_ns - self._boot_ns))
        parameters[Key.POWER_UP_COUNT] = struct.pack("<I", self._power_ups)
        parameters[Key.DIAGNOSIS] = struct.pack("<H", fault)
        parameters[Key.HMS_CODES] = struct.pack("<8I", self._hms_code, *[0] * 7)
        return parameters.read(keys)

    def _set_target(self, t_ns: int, target: WorkState) -> None:
        self._parameters[Key.WORK_TARGET] = bytes([target])
        if target is WorkState.IDLE:
            self._motor_ready_ns = None
        elif self._motor_ready_ns is None:
            start_ns = max(t_ns, self._checked_ns)
            self._motor_ready_ns = start_ns + seconds_to_ns(self._settings.motor_start_s)

    def _describe(self) -> None:
        """Set what never changes."""
        settings, parameters = self._settings, self._parameters
        parameters[Key.SERIAL] = settings.serial.encode("ascii").ljust(16, b"\0")
        parameters[Key.PRODUCT_INFO] = _PRODUCT_INFO.ljust(64, b"\0")
        parameters[Key.VERSION_APPLICATION] = bytes([35, 1, 1, 8])
        parameters[Key.VERSION_LOADER] = bytes([35, 1, 0, 0])
        parameters[Key.VERSION_HARDWARE] = bytes([35, 1, 0, 0])
        parameters[Key.MAC] = bytes([0x02, 0, 0, 0, 0, 1])
        parameters[Key.CORE_TEMPERATURE] = struct.pack("<i", round(CORE_TEMPERATURE_C * 100.0))
        parameters[Key.LAST_SYNC_TIME] = bytes(8)
        parameters[Key.TIME_OFFSET] = bytes(8)
        parameters[Key.TIME_SYNC_TYPE] = bytes([TimeType.NONE])
        parameters[Key.FIRMWARE_TYPE] = bytes([settings.firmware_type == "application"])
