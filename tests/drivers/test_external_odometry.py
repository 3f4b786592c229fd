"""Another process's MAVLink ODOMETRY: what is taken, what is refused and why, in all frames."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pymavlink.dialects.v20 import common as dialect

from companion.drivers.external_odometry import (
    MAX_DATAGRAM_SIZE,
    ExternalOdometryReceiver,
)
from companion.drivers.external_odometry_settings import ExternalOdometrySettings
from companion.drivers.px4_messages import external_odometry
from companion.geometry import frames, rotation
from companion.messages import ExternalOdometry, MavlinkMessage
from tests.drivers.odometry_sender import (
    A_MOTION,
    BODY_FLU,
    BODY_FRD,
    LOCAL_FLU,
    LOCAL_FRD,
    LOCAL_NED,
    NAN,
    Stated,
    euler,
    stated_in,
    triangle,
    unchanged,
)
from tests.drivers.px4_peer import an_odometry

SOURCE = ("127.0.0.1", 40_000)
MS = 1_000_000
START_NS = 77_000_000_000
COMBINATIONS = [(f, c) for f in (LOCAL_FRD, LOCAL_NED, LOCAL_FLU) for c in (BODY_FRD, BODY_FLU)]


class Feed:
    """A receiver and a sender at 50 Hz whose messages take 3 ms."""

    def __init__(self, **settings: object) -> None:
        self.receiver = ExternalOdometryReceiver(ExternalOdometrySettings.model_validate(settings))
        self.t_ns = START_NS

    def send(
        self, stated: Stated, t_ns: int | None = None, source: tuple[str, int] = SOURCE, **sender: int
    ) -> list[ExternalOdometry]:
        self.t_ns = self.t_ns + 20 * MS if t_ns is None else t_ns
        return self.receiver.receive(self.t_ns, source, stated.bytes(**sender))

    def run(self, epoch_ns: int, count: int = 60, **fields: object) -> list[ExternalOdometry]:
        """Send messages stamped with the host's time less an epoch."""
        found: list[ExternalOdometry] = []
        for _ in range(count):
            t_ns = self.t_ns + 20 * MS
            stated = Stated(time_usec=(t_ns - 3 * MS - epoch_ns) // 1000).with_(**fields)
            found += self.send(stated, t_ns)
        return found

    def only_refusal(self) -> str:
        refusals = self.receiver.statistics().refusals
        assert len(refusals) == 1, refusals
        return next(iter(refusals))


@pytest.mark.parametrize(("frame_id", "child_frame_id"), COMBINATIONS)
def test_one_motion_is_the_same_in_all_frames(frame_id: int, child_frame_id: int) -> None:
    (found,) = Feed().send(stated_in(A_MOTION, frame_id, child_frame_id))
    assert_allclose(found.p_map, A_MOTION.p_map, atol=1e-6)
    assert float(rotation.angle_between(found.q_map_body, A_MOTION.q_map_body)) < 1e-6
    assert_allclose(found.v_map, A_MOTION.v_map, atol=1e-6)
    assert_allclose(found.omega_body, A_MOTION.omega_body, atol=1e-6)


@pytest.mark.parametrize(("frame_id", "child_frame_id"), COMBINATIONS)
def test_covariances_follow_the_frames(frame_id: int, child_frame_id: int) -> None:
    """Samples drawn from the stated covariance scatter in our frames as the converted one says."""
    stated = stated_in(A_MOTION, frame_id, child_frame_id)
    rng = np.random.default_rng(4)
    root = rng.normal(size=(6, 6)) * np.array([0.02] * 3 + [0.002] * 3)[:, None]
    covariance = root @ root.T
    (found,) = Feed().send(stated.with_(pose_covariance=covariance[np.triu_indices(6)].tolist()))
    samples = rng.multivariate_normal(np.zeros(6), covariance, size=20_000)
    roll, pitch, yaw = euler(np.array(stated.q))
    angles = np.array([roll, pitch, yaw]) + samples[:, 3:]
    q_samples = rotation.multiply(
        rotation.from_yaw(angles[:, 2]),
        rotation.multiply(
            rotation.exp(angles[:, 1:2] * np.array([0.0, 1.0, 0.0])),
            rotation.exp(angles[:, :1] * np.array([1.0, 0.0, 0.0])),
        ),
    )
    turn_child = rotation.log(rotation.multiply(rotation.conjugate(np.array(stated.q)), q_samples))
    turn_body = frames.flu_from_frd(turn_child) if child_frame_id == BODY_FRD else turn_child
    turn_map = {LOCAL_FRD: frames.flu_from_frd, LOCAL_NED: frames.enu_from_ned, LOCAL_FLU: unchanged}
    moved = np.concatenate([turn_map[frame_id](samples[:, :3]), turn_body], axis=1)
    expected = np.cov(moved.T)
    scale = np.sqrt(np.outer(np.diagonal(expected), np.diagonal(expected)))
    assert_allclose(found.covariance_pose / scale, expected / scale, atol=0.05)
    assert_allclose(found.covariance_velocity, np.eye(3) * 1e-2, atol=1e-7)


def test_our_own_message_to_px4_comes_back_as_it_was() -> None:
    from companion.drivers.mavlink_codec import MavlinkEncoder

    odometry = an_odometry(START_NS)
    fields = external_odometry(odometry, 1_000_000, 0.02)
    assert fields is not None
    data = MavlinkEncoder().encode(MavlinkMessage("ODOMETRY", 1, 197, fields))
    (found,) = Feed().receiver.receive(START_NS, SOURCE, data)
    assert_allclose(found.p_map, odometry.p_map, atol=1e-6)
    assert float(rotation.angle_between(found.q_map_body, odometry.q_map_body)) < 1e-6
    assert_allclose(found.v_map, odometry.v_map, atol=1e-6)
    assert_allclose(found.covariance_pose, odometry.covariance_pose, rtol=1e-4, atol=1e-9)
    assert_allclose(found.covariance_velocity, odometry.covariance_velocity, rtol=1e-4, atol=1e-9)


GOOD = Stated()
HUGE = triangle(1e6, 1e6, 1e6, 1.0, 1.0, 1.0)
INDEFINITE = np.array(triangle(1e-4, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4))
INDEFINITE[1] = 2e-4
REFUSED: dict[str, tuple[Stated, str]] = {
    "frame": (GOOD.with_(frame_id=4), "frame_id 4 is not accepted"),
    "old mocap frame": (GOOD.with_(frame_id=14), "frame_id 14 is not accepted"),
    "child frame": (GOOD.with_(child_frame_id=1), "child_frame_id 1 is not accepted"),
    "position NaN": (GOOD.with_(p=(NAN, 0.0, 0.0)), "position not finite"),
    "position infinite": (GOOD.with_(p=(math.inf, 0.0, 0.0)), "position not finite"),
    "position far": (GOOD.with_(p=(3e4, 0.0, 0.0)), "position too far away"),
    "quaternion zero": (GOOD.with_(q=(0.0, 0.0, 0.0, 0.0)), "quaternion not of unit length"),
    "quaternion long": (GOOD.with_(q=(1.01, 0.0, 0.0, 0.0)), "quaternion not of unit length"),
    "quaternion NaN": (GOOD.with_(q=(NAN, 0.0, 0.0, 0.0)), "quaternion not of unit length"),
    "velocity infinite": (GOOD.with_(v=(math.inf, NAN, 0.0)), "velocity not finite"),
    "velocity large": (GOOD.with_(v=(40.0, 0.0, 0.0)), "velocity too large"),
    "rate large": (GOOD.with_(omega=(500.0, 0.0, 0.0)), "angular rate too large"),
    "covariance huge": (GOOD.with_(pose_covariance=HUGE), "covariance too large"),
    "covariance infinite": (
        GOOD.with_(pose_covariance=[math.inf, *GOOD.pose_covariance[1:]]),
        "pose covariance not finite",
    ),
    "covariance half NaN": (
        GOOD.with_(pose_covariance=[*GOOD.pose_covariance[:20], NAN]),
        "pose covariance not finite",
    ),
    "covariance negative": (
        GOOD.with_(pose_covariance=triangle(-1e-4, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4)),
        "pose covariance not positive definite",
    ),
    "covariance indefinite": (
        GOOD.with_(pose_covariance=INDEFINITE.tolist()),
        "pose covariance not positive definite",
    ),
    "velocity covariance zero": (
        GOOD.with_(velocity_covariance=triangle(0.0, 1e-2, 1e-2, 0.0, 0.0, 0.0)),
        "velocity covariance not positive definite",
    ),
    "no stamp": (GOOD.with_(time_usec=0), "stamp missing"),
    "absurd stamp": (GOOD.with_(time_usec=2**64 - 1), "stamp missing"),
}


@pytest.mark.parametrize("name", sorted(REFUSED))
def test_each_wrong_message_is_refused_for_its_reason_and_locks_nobody_out(name: str) -> None:
    wrong, reason = REFUSED[name]
    feed = Feed()
    assert feed.send(wrong) == []
    assert feed.only_refusal() == reason
    assert len(feed.send(GOOD, source=("127.0.0.1", 41_000))) == 1
    assert feed.receiver.statistics().accepted == 1


def test_unknown_covariances_are_replaced_by_the_configured_ones() -> None:
    feed = Feed(position_sigma_m=0.3, rotation_sigma_deg=2.0, velocity_sigma_mps=0.4)
    unknown = [NAN] + [0.0] * 20
    (found,) = feed.send(GOOD.with_(pose_covariance=unknown, velocity_covariance=[0.0] * 21))
    assert_allclose(np.diagonal(found.covariance_pose)[:3], 0.09)
    assert_allclose(np.diagonal(found.covariance_pose)[3:], math.radians(2.0) ** 2)
    assert_allclose(found.covariance_velocity, np.eye(3) * 0.16, atol=1e-12)


def test_a_velocity_that_is_partly_unknown_is_unknown() -> None:
    (found,) = Feed().send(GOOD.with_(v=(0.5, NAN, 0.0), omega=(NAN, 0.0, 0.0)))
    assert np.isnan(found.v_map).all()
    assert np.isnan(found.omega_body).all()


def test_failure_and_missing_quality_pass_as_they_are() -> None:
    feed = Feed()
    assert [
        feed.send(GOOD.with_(quality=q, time_usec=10**6 + 20_000 * i))[0].quality
        for i, q in enumerate((-1, 0, 100))
    ] == [-1, 0, 100]


def test_only_listed_senders_are_heard() -> None:
    feed = Feed(system_ids=[7], component_ids=[197, 198])
    assert feed.send(GOOD, system_id=1) == []
    assert feed.send(GOOD, system_id=7, component_id=1) == []
    assert len(feed.send(GOOD, system_id=7, component_id=198)) == 1
    assert set(feed.receiver.statistics().refusals) == {
        "sender 1/197 is not listened to",
        "sender 7/1 is not listened to",
    }


def test_only_listed_frames_are_taken() -> None:
    feed = Feed(frames=["local_flu"], child_frames=["body_flu"])
    assert feed.send(GOOD) == []
    assert feed.send(GOOD.with_(frame_id=LOCAL_FLU)) == []
    assert len(feed.send(GOOD.with_(frame_id=LOCAL_FLU, child_frame_id=BODY_FLU))) == 1


def test_a_second_sender_is_heard_only_after_the_first_fell_silent() -> None:
    feed = Feed()
    first = feed.run(0, 10)
    other = ("127.0.0.1", 41_000)
    stated = Stated(time_usec=feed.t_ns // 1000)
    assert feed.send(stated, feed.t_ns + MS, other) == []
    assert feed.only_refusal() == "another sender, or other frames, than before"
    t_ns = feed.t_ns + 2_100 * MS
    (taken_over,) = feed.send(stated.with_(time_usec=t_ns // 1000), t_ns, other)
    assert taken_over.session == first[-1].session + 1


def test_a_change_of_frames_in_flight_is_refused() -> None:
    feed = Feed()
    feed.run(0, 5)
    assert feed.run(0, 5, frame_id=LOCAL_FLU, child_frame_id=BODY_FLU) == []


@pytest.mark.parametrize("cut", [1, 5, 12, 100, 200])
def test_cut_and_flipped_frames_are_counted_and_raise_nothing(cut: int) -> None:
    feed = Feed()
    data = GOOD.bytes()
    assert feed.receiver.receive(START_NS, SOURCE, data[:cut]) == []
    flipped = bytearray(data)
    flipped[cut] ^= 0x10
    assert feed.receiver.receive(START_NS, SOURCE, bytes(flipped)) == []
    assert feed.only_refusal() == "no MAVLink message"
    assert len(feed.send(GOOD)) == 1


def test_arbitrary_bytes_never_raise() -> None:
    rng = np.random.default_rng(1)
    feed = Feed()
    for size in rng.integers(0, 600, 200):
        noise = bytes(rng.integers(0, 256, int(size), dtype=np.uint8))
        assert feed.receiver.receive(START_NS, SOURCE, b"\xfd" + noise) == []


def test_fields_of_random_bits_never_raise_and_are_never_half_taken() -> None:
    rng = np.random.default_rng(2)
    kind = dialect.MAVLink_odometry_message
    sender = dialect.MAVLink(None, 1, 197)
    feed = Feed()
    for index in range(300):
        payload = bytearray(rng.integers(0, 256, kind.unpacker.size, dtype=np.uint8))
        values = kind.unpacker.unpack(bytes(payload))
        message = kind(*_by_declaration(kind, values))
        message.frame_id, message.child_frame_id = LOCAL_FRD, BODY_FRD
        with np.errstate(all="ignore"):
            data = bytes(message.pack(sender))
        for found in feed.receiver.receive(START_NS + index * 20 * MS, SOURCE, data):
            assert np.isfinite(found.p_map).all()
            assert np.isfinite(found.covariance_pose).all()


def _by_declaration(kind: type, values: tuple[object, ...]) -> list[object]:
    wire: dict[str, object] = {}
    position = 0
    lengths = zip(kind.ordered_fieldnames, kind.lengths, strict=True)  # type: ignore[attr-defined]
    for name, length in lengths:
        wire[name] = list(values[position : position + length]) if length > 1 else values[position]
        position += length
    return [wire[name] for name in kind.fieldnames]  # type: ignore[attr-defined]


def test_large_datagrams_and_floods_are_bounded() -> None:
    feed = Feed()
    assert feed.receiver.receive(START_NS, SOURCE, bytes(MAX_DATAGRAM_SIZE + 1)) == []
    many = b"".join(Stated(time_usec=10**6 + i * 20_000).bytes() for i in range(8))
    assert len(feed.receiver.receive(START_NS, SOURCE, many)) == 4
    assert feed.receiver.statistics().refusals == {
        "datagram too large": 1,
        "too many messages in a datagram": 4,
    }


def test_reasons_are_counted_in_bounded_memory() -> None:
    feed = Feed(system_ids=[250])
    for system_id in range(1, 200):
        feed.send(GOOD, system_id=system_id)
    refusals = feed.receiver.statistics().refusals
    assert len(refusals) <= 65
    assert sum(refusals.values()) == 199
    assert refusals["other reasons"] > 100


def test_other_messages_are_not_odometry() -> None:
    feed = Feed()
    heartbeat = dialect.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3).pack(dialect.MAVLink(None, 1, 197))
    assert feed.receiver.receive(START_NS, SOURCE, bytes(heartbeat)) == []
    assert feed.only_refusal() == "HEARTBEAT instead of ODOMETRY"
