import struct
from collections import Counter
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import development as dialect

from sitl.mavlink_emulator import EmulatorSettings, MavlinkEmulator, Peer
from sitl.mavlink_schedule import ONBOARD_RATES_HZ
from tests.sitl.autopilot_rig import Rig

_CAPTURES = Path(__file__).parents[2] / ".." / "shared" / "data"


def _captured_rates(path: Path) -> dict[str, float]:
    """Rates of everything component 1 sent in a timestamped capture, in Hz."""
    data = path.read_bytes()
    position, counts, times = 0, Counter[str](), []
    while position + 20 < len(data):
        (t_us,) = struct.unpack(">Q", data[position : position + 8])
        frame = data[position + 8 :]
        length = 12 + frame[1] + (13 if frame[2] & 1 else 0)
        number = frame[7] | frame[8] << 8 | frame[9] << 16
        if frame[6] == 1 and number in dialect.mavlink_map:
            counts[dialect.mavlink_map[number].msgname] += 1
        times.append(t_us)
        position += 8 + length
    return {name: count / ((times[-1] - times[0]) * 1e-6) for name, count in counts.items()}


@pytest.mark.parametrize(("name", "gnss"), [("gps", True), ("gnss_denied", False)])
def test_stream_rates_are_those_of_the_captured_px4(name: str, gnss: bool) -> None:
    path = _CAPTURES / f"px4_capture_{name}.tlog"
    if not path.exists():
        pytest.skip("no capture here")
    captured = _captured_rates(path)
    rig = Rig(gnss=gnss)
    rig.run(4.0)
    emulator = MavlinkEmulator(rig.autopilot, EmulatorSettings(clock_slow=0.007))
    parser, counts = dialect.MAVLink(None), Counter[str]()
    for _ in range(1600):
        rig.t_ns += 5_000_000
        for item in emulator.poll(rig.t_ns):
            if item.peer is Peer.COMPANION:
                counts.update(m.get_type() for m in parser.parse_buffer(item.payload) or [])
    for stream in (*ONBOARD_RATES_HZ, "TIMESYNC"):
        if stream == "EXTENDED_SYS_STATE":
            continue  # the captured client lowered it to 1 Hz
        assert counts[stream] / 8.0 == pytest.approx(captured.get(stream, 0.0), rel=0.04, abs=0.2), stream
