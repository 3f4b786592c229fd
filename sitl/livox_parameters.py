"""Parameters of the emulated Mid-360: which keys exist, what may be written, what a query returns.

What real firmware does with a partly bad write of several keys is not known; here nothing of it takes
effect and the first bad key is named.
"""

import struct
from collections.abc import Callable

from companion.drivers.livox_protocol import (
    BROADCAST_IP,
    Key,
    Parameters,
    ReturnCode,
    StreamAddress,
    WorkState,
    pack_ip,
)

# The order in which a real unit pushes its state.
PUSH_KEYS: tuple[Key, ...] = (
    Key.PCL_DATA_TYPE, Key.PATTERN_MODE, Key.LIDAR_ADDRESS, Key.STATE_HOST, Key.POINT_HOST, Key.IMU_HOST,
    Key.INSTALL_ATTITUDE, Key.FOV_0, Key.FOV_1, Key.FOV_ENABLE, Key.DETECT_MODE, Key.FUNCTION_IO,
    Key.WORK_TARGET, Key.IMU_DATA_ENABLE, Key.MOTOR_SPEED, Key.SERIAL, Key.PRODUCT_INFO,
    Key.VERSION_APPLICATION, Key.VERSION_LOADER, Key.VERSION_HARDWARE, Key.MAC, Key.WORK_STATE,
    Key.CORE_TEMPERATURE, Key.POWER_UP_COUNT, Key.LOCAL_TIME, Key.LAST_SYNC_TIME, Key.TIME_OFFSET,
    Key.TIME_SYNC_TYPE, Key.DIAGNOSIS, Key.FIRMWARE_TYPE, Key.HMS_CODES,
)  # fmt: skip
READ_ONLY_FROM = 0x8000
WORK_TARGETS = (WorkState.SAMPLING, WorkState.IDLE, WorkState.READY)


def _one_of(*allowed: int) -> Callable[[bytes], bool]:
    return lambda value: value[0] in allowed


def _anything(_: bytes) -> bool:
    return True


def _is_field_of_view(value: bytes) -> bool:
    yaw_start, yaw_stop, pitch_start, pitch_stop, _ = struct.unpack("<4iI", value)
    return all(0 <= yaw <= 360 for yaw in (yaw_start, yaw_stop)) and all(
        -10 <= pitch <= 60 for pitch in (pitch_start, pitch_stop)
    )


_FIELD_OF_VIEW = struct.pack("<4iI", 0, 0, -7, 52, 0)
_WRITABLE: dict[int, tuple[bytes, Callable[[bytes], bool]]] = {
    Key.PCL_DATA_TYPE: (b"\x01", _one_of(1, 2, 3)),
    Key.PATTERN_MODE: (b"\x00", _one_of(0)),
    Key.POINT_SEND: (b"\x00", _one_of(0, 1)),
    Key.LIDAR_ADDRESS: (bytes(12), _anything),
    Key.STATE_HOST: (StreamAddress(BROADCAST_IP, 56_201).pack(), _anything),
    Key.POINT_HOST: (bytes(8), _anything),
    Key.IMU_HOST: (bytes(8), _anything),
    Key.INSTALL_ATTITUDE: (bytes(24), _anything),
    Key.FOV_0: (_FIELD_OF_VIEW, _is_field_of_view),
    Key.FOV_1: (_FIELD_OF_VIEW, _is_field_of_view),
    Key.FOV_ENABLE: (b"\x00", _one_of(0, 1, 2, 3)),
    Key.DETECT_MODE: (b"\x00", _one_of(0, 1)),
    Key.FUNCTION_IO: (bytes(4), _anything),
    Key.WORK_TARGET: (bytes([WorkState.IDLE]), _one_of(*WORK_TARGETS)),
    Key.IMU_DATA_ENABLE: (b"\x01", _one_of(0, 1)),
    Key.MOTOR_SPEED: (b"\x00", _one_of(0, 1)),
    Key.TIME_FILTER: (b"\x00", _one_of(0, 1)),
}


class ParameterStore:
    """Values of all keys."""

    def __init__(self, lidar_ip: str) -> None:
        """Start with factory values and the sensor's own address."""
        self._lidar_ip = lidar_ip
        self._values: dict[int, bytes] = {}
        self.restore_factory_values()

    def restore_factory_values(self) -> None:
        """Forget everything written; read-only values stay."""
        self._values.update({key: value for key, (value, _) in _WRITABLE.items()})
        network = pack_ip("255.255.255.0") + pack_ip(self._lidar_ip)[:3] + b"\x01"
        self._values[Key.LIDAR_ADDRESS] = pack_ip(self._lidar_ip) + network

    def __getitem__(self, key: int) -> bytes:
        """Return the value of a known key."""
        return self._values[key]

    def __setitem__(self, key: int, value: bytes) -> None:
        """Store a value without any check: the sensor's own doing."""
        self._values[key] = value

    def read(self, keys: list[int]) -> list[tuple[int, bytes]]:
        """Return the values of those keys that exist."""
        return [(key, self._values[key]) for key in keys if key in self._values]

    def write(self, parameters: Parameters) -> tuple[ReturnCode, int]:
        """Store values from the host if all of them are good.

        Returns:
            The return code and the first bad key, or 0.
        """
        for key, value in parameters:
            code = _judge(key, value)
            if code is not ReturnCode.OK:
                return code, key
        self._values.update(parameters)
        for key, _ in parameters:
            if key == Key.LIDAR_ADDRESS:
                return ReturnCode.NEEDS_REBOOT, key
        return ReturnCode.OK, 0


def _judge(key: int, value: bytes) -> ReturnCode:
    if key >= READ_ONLY_FROM:
        return ReturnCode.READ_ONLY if key in list(Key) else ReturnCode.NOT_SUPPORTED
    if key not in _WRITABLE:
        return ReturnCode.NOT_SUPPORTED
    factory_value, is_valid = _WRITABLE[key]
    if len(value) != len(factory_value):
        return ReturnCode.WRONG_LENGTH
    return ReturnCode.OK if is_valid(value) else ReturnCode.OUT_OF_RANGE
