"""What a Livox Mid-360 says about itself: identity, working state, temperature, health codes."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

from companion.drivers.livox_protocol import Key, WorkState, unpack_text

_HMS_LEVELS = {1: "information", 2: "warning", 3: "error", 4: "fatal"}
_HMS_NAMES = {
    0x0102: "temperature is high",
    0x0103: "temperature is too high",
    0x0104: "window is dirty",
    0x0111: "internal temperature is high",
    0x0112: "internal temperature is too high",
    0x0113: "IMU has stopped",
    0x0114: "temperature is high",
    0x0115: "temperature is too high",
    0x0116: "supply voltage is out of range",
    0x0117: "parameters are damaged",
    0x0118: "device is damaged",
    0x0201: "scan module is heating",
    0x0401: "network link was down",
    0x0402: "PTP stopped or has a gap",
    0x0403: "PTP version 2.1 is not supported",
}


@dataclass(frozen=True, slots=True)
class LidarInfo:
    """What the sensor last said about itself; None or empty where it has said nothing yet.

    Attributes:
        device_type: 9 for a Mid-360, 35 for a Mid-360s.
        time_sync_type: 0 none, 1 PTP, 2 GPS; stays 1 after a PTP master has gone.
        last_sync_ns: sensor time of the last synchronisation.
        hms_codes: health codes other than zero.
    """

    serial: str = ""
    device_type: int | None = None
    product: str = ""
    firmware_version: str = ""
    firmware_type: int | None = None
    work_state: int | None = None
    core_temperature_c: float | None = None
    time_sync_type: int | None = None
    last_sync_ns: int | None = None
    hms_codes: tuple[int, ...] = ()


def with_parameters(info: LidarInfo, parameters: Iterable[tuple[int, bytes]]) -> LidarInfo:
    """Return `info` updated with parameter values; values of a wrong length are ignored."""
    for key, value in parameters:
        size = len(value)
        number = int.from_bytes(value, "little")
        if key == Key.SERIAL and size == 16:
            info = replace(info, serial=unpack_text(value))
        elif key == Key.PRODUCT_INFO and size == 64:
            info = replace(info, product=unpack_text(value))
        elif key == Key.VERSION_APPLICATION and size == 4:
            info = replace(info, firmware_version=".".join(str(part) for part in value))
        elif key == Key.FIRMWARE_TYPE and size == 1:
            info = replace(info, firmware_type=number)
        elif key == Key.WORK_STATE and size == 1:
            info = replace(info, work_state=number)
        elif key == Key.CORE_TEMPERATURE and size == 4:
            hundredths = int.from_bytes(value, "little", signed=True)
            info = replace(info, core_temperature_c=hundredths / 100.0)
        elif key == Key.TIME_SYNC_TYPE and size == 1:
            info = replace(info, time_sync_type=number)
        elif key == Key.LAST_SYNC_TIME and size == 8:
            info = replace(info, last_sync_ns=number)
        elif key == Key.HMS_CODES and size == 32:
            codes = (int.from_bytes(value[at : at + 4], "little") for at in range(0, 32, 4))
            info = replace(info, hms_codes=tuple(code for code in codes if code))
    return info


def describe_work_state(state: int | None) -> str:
    """Return a working state in words."""
    if state is None:
        return "unknown"
    try:
        return WorkState(state).name.lower().replace("_", " ")
    except ValueError:
        return f"unknown state 0x{state:02x}"


def describe_hms(code: int) -> str:
    """Return a health code in words, with its number."""
    name, level = _HMS_NAMES.get(code >> 16, ""), _HMS_LEVELS.get(code & 0xFFFF, "unknown level")
    if not name and 0x0210 <= code >> 16 <= 0x0219:
        name = "scan module fails"
    if not name and 0x0404 <= code >> 16 <= 0x040A:
        name = "time synchronisation fails"
    return f"{name or 'unlisted'} ({level}, 0x{code:08x})"
