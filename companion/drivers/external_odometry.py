"""From datagrams of another process to its odometry in our frames: MAVLink ODOMETRY, checked.

No sockets, no clock: each datagram comes with its receive time. Nothing that arrives can make the
receiver raise or grow; whatever is not taken is counted by its reason.
"""

import math
from collections import Counter
from dataclasses import dataclass

import numpy as np

from companion.clock import seconds_to_ns
from companion.drivers.external_odometry_clock import SourceClockFollower, StampVerdict
from companion.drivers.external_odometry_frames import CHILD_FRAME_IDS, FRAME_IDS, StatedMotion, to_map
from companion.drivers.external_odometry_settings import ChildFrame, ExternalOdometrySettings, Frame
from companion.drivers.mavlink_codec import MavlinkParser
from companion.errors import ProtocolError
from companion.geometry import rotation
from companion.geometry.rotation import FloatArray
from companion.messages import ExternalOdometry, MavlinkMessage

MAX_DATAGRAM_SIZE = 2048
MAX_MESSAGES_PER_DATAGRAM = 4

_MESSAGE = "ODOMETRY"
_TRIANGLE = np.triu_indices(6)
_TRIANGLE_SIZE = 21
_NORM_TOLERANCE = 1e-3
_LEAST_EIGENVALUE = 1e-6  # of the correlations: less is no more than float32's rounding
_MAX_RATE = 200.0  # rad/s
_MAX_REASONS = 64
_OTHER_REASONS = "other reasons"


class RefusedError(ProtocolError):
    """A message that is not taken; the text is the reason under which it is counted."""


@dataclass(frozen=True, slots=True)
class _Sender:
    """Whose odometry is followed: one process with one choice of frames."""

    address: tuple[str, int]
    system_id: int
    component_id: int
    frame: Frame
    child_frame: ChildFrame


@dataclass(frozen=True, slots=True)
class ExternalOdometryStatistics:
    """What has been received since the start.

    Attributes:
        datagrams: all that arrived.
        accepted: messages that were taken.
        refused: datagrams and messages that were not, whatever the reason.
        sessions: senders and clocks that have begun so far.
        quality: of the newest accepted message, as it states it.
        clock_offset_ns: host time minus the sender's.
        t_accepted_ns: host time of the newest accepted message, None before the first.
        refusals: how many were refused, by reason.
    """

    datagrams: int
    accepted: int
    refused: int
    sessions: int
    quality: int
    clock_offset_ns: int
    t_accepted_ns: int | None
    refusals: dict[str, int]


class ExternalOdometryReceiver:
    """Follows one sender at a time."""

    def __init__(self, settings: ExternalOdometrySettings) -> None:
        """Wait for a first sender."""
        self._settings = settings
        self._silence_ns = seconds_to_ns(settings.silence_timeout_s)
        self._clock = SourceClockFollower(settings)
        self._sender: _Sender | None = None
        self._t_accepted_ns: int | None = None
        self._datagrams = self._accepted = self._sessions = self._quality = 0
        self._refusals: Counter[str] = Counter()

    def statistics(self) -> ExternalOdometryStatistics:
        """Return a snapshot of all counters."""
        refusals = dict(self._refusals)
        return ExternalOdometryStatistics(
            self._datagrams,
            self._accepted,
            sum(refusals.values()),
            self._sessions,
            self._quality,
            self._clock.offset_ns,
            self._t_accepted_ns,
            refusals,
        )

    def receive(
        self, t_ns: int, source: tuple[str, int], payload: bytes | memoryview
    ) -> list[ExternalOdometry]:
        """Take one datagram received at host time `t_ns`; return what is accepted of it; never raises."""
        self._datagrams += 1
        if len(payload) > MAX_DATAGRAM_SIZE:
            self._refuse("datagram too large")
            return []
        # A datagram holds whole frames, so nothing of one sender's bytes is kept for the next.
        messages = MavlinkParser().feed(bytes(payload))
        if not messages:
            self._refuse("no MAVLink message")
        accepted: list[ExternalOdometry] = []
        for index, message in enumerate(messages):
            if index >= MAX_MESSAGES_PER_DATAGRAM:
                self._refuse("too many messages in a datagram")
            else:
                accepted.extend(self._judged(t_ns, source, message))
        return accepted

    def _judged(self, t_ns: int, source: tuple[str, int], message: MavlinkMessage) -> list[ExternalOdometry]:
        try:
            return [self._take(t_ns, source, message)]
        except RefusedError as refusal:
            self._refuse(str(refusal))
            return []

    def _refuse(self, reason: str) -> None:
        if reason not in self._refusals and len(self._refusals) >= _MAX_REASONS:
            reason = _OTHER_REASONS
        self._refusals[reason] += 1

    def _take(self, t_ns: int, source: tuple[str, int], message: MavlinkMessage) -> ExternalOdometry:
        settings = self._settings
        if message.name != _MESSAGE:
            raise RefusedError(f"{message.name} instead of {_MESSAGE}")
        if (settings.system_ids and message.system_id not in settings.system_ids) or (
            settings.component_ids and message.component_id not in settings.component_ids
        ):
            raise RefusedError(f"sender {message.system_id}/{message.component_id} is not listened to")
        fields = message.fields
        sender = _Sender(source, message.system_id, message.component_id, *self._frames(fields))
        followed = self._sender is None or sender == self._sender
        silent = self._t_accepted_ns is not None and t_ns - self._t_accepted_ns > self._silence_ns
        if not followed and not silent:
            raise RefusedError("another sender, or other frames, than before")
        motion = to_map(self._motion(fields), sender.frame, sender.child_frame)
        clock = self._clock if sender == self._sender else SourceClockFollower(settings)
        time_usec = _integer(fields, "time_usec")
        verdict = clock.judge(t_ns, time_usec)
        if verdict is StampVerdict.BEGUN_ANEW:
            self._sessions += 1
        elif verdict is not StampVerdict.ACCEPTED:
            raise RefusedError(verdict.value)
        self._clock, self._sender = clock, sender
        self._accepted += 1
        self._t_accepted_ns = t_ns
        self._quality = _integer(fields, "quality")
        return ExternalOdometry(
            t_ns=t_ns,
            t_source_ns=time_usec * 1000,
            clock_offset_ns=clock.offset_ns,
            on_lidar_clock=settings.clock == "lidar",
            session=self._sessions,
            p_map=motion.p,
            q_map_body=motion.q,
            v_map=motion.v,
            omega_body=motion.omega,
            covariance_pose=motion.covariance_pose,
            covariance_velocity=motion.covariance_velocity,
            quality=max(-1, min(self._quality, 100)),
            reset_counter=_integer(fields, "reset_counter"),
        )

    def _frames(self, fields: dict[str, object]) -> tuple[Frame, ChildFrame]:
        frame_id, child_id = _integer(fields, "frame_id"), _integer(fields, "child_frame_id")
        frame, child_frame = FRAME_IDS.get(frame_id), CHILD_FRAME_IDS.get(child_id)
        if frame is None or frame not in self._settings.frames:
            raise RefusedError(f"frame_id {frame_id} is not accepted")
        if child_frame is None or child_frame not in self._settings.child_frames:
            raise RefusedError(f"child_frame_id {child_id} is not accepted")
        return frame, child_frame

    def _motion(self, fields: dict[str, object]) -> StatedMotion:
        """Return what a message states, checked, in its own frames."""
        settings = self._settings
        p = _vector(fields, "x", "y", "z")
        if not float(np.linalg.norm(p)) <= settings.max_distance_m:
            raise RefusedError("position too far away" if np.isfinite(p).all() else "position not finite")
        q = np.array(fields["q"], dtype=np.float64)
        norm = float(np.linalg.norm(q))
        if not abs(norm - 1.0) <= _NORM_TOLERANCE:
            raise RefusedError("quaternion not of unit length")
        v = _known(_vector(fields, "vx", "vy", "vz"))
        if float(np.linalg.norm(v)) > settings.max_speed_mps:
            raise RefusedError("velocity too large")
        omega = _known(_vector(fields, "rollspeed", "pitchspeed", "yawspeed"))
        if float(np.linalg.norm(omega)) > _MAX_RATE:
            raise RefusedError("angular rate too large")
        sigma_rad = math.radians(settings.rotation_sigma_deg)
        pose = _covariance(
            fields["pose_covariance"], [settings.position_sigma_m] * 3 + [sigma_rad] * 3, "pose covariance"
        )
        twist = _covariance(
            fields["velocity_covariance"],
            [settings.velocity_sigma_mps] * 3 + [1.0] * 3,
            "velocity covariance",
            used=3,
        )
        sigmas = np.sqrt(np.diagonal(pose))
        if (
            float(sigmas[:3].max()) > settings.max_position_sigma_m
            or float(sigmas[3:].max()) > math.radians(settings.max_rotation_sigma_deg)
            or math.sqrt(float(np.diagonal(twist)[:3].max())) > settings.max_velocity_sigma_mps
        ):
            raise RefusedError("covariance too large")
        return StatedMotion(p, rotation.normalize(q), v, omega, pose, twist[:3, :3])


def _vector(fields: dict[str, object], *names: str) -> FloatArray:
    return np.array([fields[name] for name in names], dtype=np.float64)


def _known(vector: FloatArray) -> FloatArray:
    """Return a vector that is finite or, when any of its numbers is missing, missing as a whole."""
    if np.isinf(vector).any():
        raise RefusedError("velocity not finite")
    return np.full(3, np.nan) if np.isnan(vector).any() else vector


def _integer(fields: dict[str, object], name: str) -> int:
    value = fields[name]
    return value if isinstance(value, int) else 0


def _covariance(values: object, default_sigmas: list[float], name: str, used: int = 6) -> FloatArray:
    """Return a matrix (6, 6) of its upper triangle (21), or the default where the sender knows nothing.

    NaN first means that nothing is known, as MAVLink has it; so do zeros alone, as many senders have it.
    """
    triangle = np.array(values, dtype=np.float64)
    if triangle.shape != (_TRIANGLE_SIZE,):
        raise RefusedError(f"{name} of the wrong size")
    if math.isnan(triangle[0]) or not triangle.any():
        return np.diag(np.square(default_sigmas))
    covariance = np.zeros((6, 6))
    covariance[_TRIANGLE] = triangle
    covariance.T[_TRIANGLE] = triangle
    part = covariance[:used, :used]
    if not np.isfinite(part).all():
        raise RefusedError(f"{name} not finite")
    if float(np.diagonal(part).min()) <= 0.0:
        raise RefusedError(f"{name} not positive definite")
    sigmas = np.sqrt(np.diagonal(part))
    # As correlations, so that metres and radians weigh alike.
    eigenvalues = np.linalg.eigvalsh(part / np.outer(sigmas, sigmas))
    if float(eigenvalues[0]) < _LEAST_EIGENVALUE:
        raise RefusedError(f"{name} not positive definite")
    return covariance
