"""What a real PX4 sent: read completely, understood, and survived when damaged."""

import struct
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import development as dialect

from companion.drivers.mavlink_codec import MAX_FRAME_BYTES, MavlinkEncoder, MavlinkParser
from companion.drivers.px4_session import Px4Session
from companion.drivers.px4_settings import Px4Settings
from companion.messages import LandedState, VehicleMode

_DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
GPS = _DATA / "px4_capture_gps.tlog"
GNSS_DENIED = _DATA / "px4_capture_gnss_denied.tlog"

pytestmark = pytest.mark.skipif(not GPS.exists(), reason="the captures are not here")


def frames(path: Path) -> Iterator[tuple[int, bytes]]:
    """Yield (microseconds, frame) of a capture: each frame follows eight bytes of time."""
    data = path.read_bytes()
    position = 0
    while position < len(data):
        (t_us,) = struct.unpack_from(">Q", data, position)
        start, length = data[position + 8], data[position + 9]
        assert start == 0xFD
        size = 12 + length + (13 if data[position + 10] & 1 else 0)
        yield t_us, data[position + 8 : position + 8 + size]
        position += 8 + size


@pytest.mark.parametrize(("path", "total"), [(GPS, 27021), (GNSS_DENIED, 25681)])
def test_a_capture_is_read_completely_and_written_again_the_same(path: Path, total: int) -> None:
    parser, encoder = MavlinkParser(), MavlinkEncoder()
    names: Counter[str] = Counter()
    for index, (_, frame) in enumerate(frames(path)):
        messages = parser.feed(frame)
        assert parser.buffered_bytes == 0
        if not messages:
            continue
        (message,) = messages
        names[message.name] += 1
        if index % 5 == 0:
            again = encoder.encode(message)
            # The sequence number and with it the checksum are our own.
            assert again[:4] + again[5:-2] == frame[:4] + frame[5:-2], message.name
    statistics = parser.statistics
    assert statistics.frames + statistics.unknown == total
    assert statistics.bad_checksums == statistics.skipped_bytes == statistics.bad_flags == 0
    assert names["LOCAL_POSITION_NED"] > 1800
    assert names["CURRENT_MODE"] >= 30


def test_the_session_follows_a_flight_with_gps() -> None:
    session, parser = Px4Session(Px4Settings(system_id=1)), MavlinkParser()
    modes: list[VehicleMode] = []
    landed: set[LandedState] = set()
    highest, fastest = 0.0, 0.0
    t_ns = 0
    for t_us, frame in frames(GPS):
        t_ns = t_us * 1000
        for message in parser.feed(frame):
            session.receive(message, t_ns)
        state = session.vehicle_state(t_ns)
        landed.add(state.landed)
        highest = max(highest, float(state.p_map[2]))
        fastest = max(fastest, float(np.linalg.norm(state.v_map)))
        if state.connected and (not modes or modes[-1] is not state.mode):
            modes.append(state.mode)
    assert modes[0] is VehicleMode.HOLD
    assert {VehicleMode.TAKEOFF, VehicleMode.OFFBOARD} <= set(modes)
    assert landed >= {LandedState.ON_GROUND, LandedState.TAKING_OFF, LandedState.IN_AIR}
    # It flew 3 m high; up is positive in the map.
    assert 2.5 < highest < 20.0
    assert 0.5 < fastest < 6.0
    statistics = session.statistics(t_ns)
    assert statistics.malformed == 0
    assert statistics.foreign == {}
    assert not statistics.suspect
    health = session.health()
    assert health.battery_percent > 0
    assert 10.0 < health.battery_v < 20.0
    assert np.isfinite(health.position_variance_m2)


def test_the_session_follows_a_flight_on_external_vision() -> None:
    session, parser = Px4Session(Px4Settings(system_id=1)), MavlinkParser()
    modes = set()
    previous_counter = 0
    jumps = 0
    t_ns = 0
    for t_us, frame in frames(GNSS_DENIED):
        t_ns = t_us * 1000
        for message in parser.feed(frame):
            session.receive(message, t_ns)
        state = session.vehicle_state(t_ns)
        modes.add(state.mode)
        jumps += state.estimator_reset_counter != previous_counter
        previous_counter = state.estimator_reset_counter
    assert {VehicleMode.HOLD, VehicleMode.OFFBOARD} <= modes
    assert jumps > 0
    assert session.statistics(t_ns).malformed == 0


def test_damaged_frames_never_raise_and_never_make_the_state_unusable() -> None:
    rng = np.random.default_rng(11)
    session, parser = Px4Session(Px4Settings(system_id=1)), MavlinkParser()
    real = [frame for _, frame in frames(GNSS_DENIED)]
    for index in range(21_000):
        frame = bytearray(real[index % len(real)])
        for _ in range(int(rng.integers(1, 4))):
            kind = int(rng.integers(0, 4))
            if kind == 0 and frame:
                frame[int(rng.integers(len(frame)))] ^= 1 << int(rng.integers(8))
            elif kind == 1 and frame:
                frame[int(rng.integers(len(frame)))] = int(rng.integers(256))
            elif kind == 2:
                del frame[int(rng.integers(len(frame) + 1)) :]
            else:
                frame[int(rng.integers(len(frame) + 1)) : 0] = rng.bytes(int(rng.integers(1, 20)))
        for message in parser.feed(bytes(frame)):
            session.receive(message, index * 1_000_000)
        assert parser.buffered_bytes < MAX_FRAME_BYTES + 13
    assert parser.statistics.bad_checksums > 1000


def test_right_checksums_over_mutated_fields_never_raise() -> None:
    rng = np.random.default_rng(12)
    session, encoder, parser = Px4Session(Px4Settings(system_id=1)), MavlinkEncoder(), MavlinkParser()
    used = [m for _, frame in frames(GPS) for m in MavlinkParser().feed(frame)][::9]
    t_ns = 0
    for message in used * 7:
        frame = bytearray(encoder.encode(message))
        payload = frame[10:-2]
        for _ in range(int(rng.integers(1, 6))):
            payload[int(rng.integers(len(payload)))] = int(rng.integers(256))
        # A peer that is wrong, not a wire that is: the checksum fits the damage.
        (damaged,) = parser.feed(_resealed(bytes(frame[:10]), bytes(payload)))
        t_ns += 1_000_000
        session.receive(damaged, t_ns)
    state = session.vehicle_state(t_ns)
    assert all(np.isfinite(vector).all() for vector in (state.p_map, state.v_map, state.q_map_body))
    assert session.statistics(t_ns).malformed > 100


def _resealed(header: bytes, payload: bytes) -> bytes:
    seed = dialect.mavlink_map[int.from_bytes(header[7:10], "little")].crc_extra
    crc = dialect.x25crc(header[1:] + payload + bytes((seed,))).crc
    return header + payload + struct.pack("<H", crc)
