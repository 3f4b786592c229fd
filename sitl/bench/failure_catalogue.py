"""Failures of sensors and mounts, injected into the events of a clean flight.

Each takes what the sensors reported from the moment of failure on and returns what a failed one would
have reported. Magnitudes are such that they matter: of the steps of bias most put the pose wrong by more
than 5 cm within a second if nobody notices. Smaller ones exist that do harm more slowly; they are not here.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from companion.clock import seconds_to_ns
from companion.geometry import rotation
from companion.messages import FloatArray, ImuSample, LidarScan
from sitl.bench.synthetic_flights import T_BODY_LIDAR, Flight

Event = ImuSample | LidarScan

_ACCEL_FULL_SCALE = 78.5  # m/s^2, 8 g
_GYRO_FULL_SCALE = 34.9  # rad/s, 2000 deg/s
_SLIP_NS = 30_000_000
_LEAST_WRONG_RATE = 0.25  # rad/s
_GROUND_RANGE_M = 30.0


@dataclass(frozen=True, eq=False)
class Moment:
    """When and where a failure happens.

    Attributes:
        flight: the clean flight, whole.
        before: events up to the failure, the newest last.
        after: those that follow it.
        t_sensor_ns: the moment; `before` ends with its sample.
    """

    flight: Flight
    before: Sequence[Event]
    after: Sequence[Event]
    t_sensor_ns: int

    def last_sample(self) -> ImuSample:
        """Return the newest IMU sample before the failure."""
        return next(event for event in reversed(self.before) if isinstance(event, ImuSample))

    def last_scan(self) -> LidarScan:
        """Return the newest scan before the failure."""
        return next(event for event in reversed(self.before) if isinstance(event, LidarScan))


Injection = Callable[[Moment, Generator], list[Event] | None]
"""Returns the changed events after the failure, or None where it would do no harm."""


def imu_stops(moment: Moment, rng: Generator) -> list[Event] | None:
    """No more IMU samples; scans go on."""
    return [event for event in moment.after if isinstance(event, LidarScan)]


def lidar_stops(moment: Moment, rng: Generator) -> list[Event] | None:
    """No more scans; IMU samples go on."""
    return [event for event in moment.after if isinstance(event, ImuSample)]


def lidar_blocked(moment: Moment, rng: Generator) -> list[Event] | None:
    """Nothing returns any more, or everything does from 0.2 to 0.5 m."""
    vanishes = rng.uniform() < 0.5

    def block(scan: LidarScan, hit: NDArray[np.bool_]) -> LidarScan:
        if vanishes:
            return _only(scan, ~hit)
        ranges = np.linalg.norm(scan.points_lidar, axis=1, keepdims=True)
        near = scan.points_lidar / np.maximum(ranges, 1e-6) * rng.uniform(0.2, 0.5, ranges.shape)
        return _with_points(scan, np.where(hit[:, None], near, scan.points_lidar))

    return _scans(moment, block)


def imu_frozen(moment: Moment, rng: Generator) -> list[Event] | None:
    """The newest values repeat under new stamps."""
    stuck = moment.last_sample()
    return _samples(moment, lambda gyro, accel: (stuck.gyro_imu, stuck.accel_imu))


def imu_saturated(moment: Moment, rng: Generator) -> list[Event] | None:
    """One axis reads full scale."""
    axis, sign, gyro_fails = int(rng.integers(3)), float(rng.choice([-1.0, 1.0])), rng.uniform() < 0.5

    def saturate(gyro: FloatArray, accel: FloatArray) -> tuple[FloatArray, FloatArray]:
        gyro, accel = gyro.copy(), accel.copy()
        if gyro_fails:
            gyro[axis] = sign * _GYRO_FULL_SCALE
        else:
            accel[axis] = sign * _ACCEL_FULL_SCALE
        return gyro, accel

    return _samples(moment, saturate)


def gyro_bias_step(moment: Moment, rng: Generator) -> list[Event] | None:
    """0.2 to 0.5 rad/s from one sample to the next."""
    step = rng.uniform(0.2, 0.5) * _direction(rng)
    return _samples(moment, lambda gyro, accel: (gyro + step, accel))


def accel_bias_step(moment: Moment, rng: Generator) -> list[Event] | None:
    """1.5 to 3 m/s^2 from one sample to the next."""
    step = rng.uniform(1.5, 3.0) * _direction(rng)
    return _samples(moment, lambda gyro, accel: (gyro, accel + step))


def gyro_axis_wrong(moment: Moment, rng: Generator) -> list[Event] | None:
    """One axis reads reversed or two to three times too much, while there is a rate to read."""
    ahead = [event.gyro_imu for event in moment.after[:40] if isinstance(event, ImuSample)]
    axis = int(np.argmax(np.abs(np.mean(ahead, axis=0))))
    factor = -1.0 if rng.uniform() < 0.5 else float(rng.uniform(2.0, 3.0))
    if abs(float(np.mean(ahead, axis=0)[axis]) * (factor - 1.0)) < _LEAST_WRONG_RATE:
        return None
    scale = np.ones(3)
    scale[axis] = factor
    return _samples(moment, lambda gyro, accel: (gyro * scale, accel))


def accel_axis_wrong(moment: Moment, rng: Generator) -> list[Event] | None:
    """The axis that carries the weight reads reversed, or 15 to 50 % wrong."""
    factor = -1.0 if rng.uniform() < 0.3 else 1.0 + float(rng.choice([-1.0, 1.0]) * rng.uniform(0.15, 0.5))
    scale = np.array([1.0, 1.0, factor])
    return _samples(moment, lambda gyro, accel: (gyro, accel * scale))


def scan_repeated(moment: Moment, rng: Generator) -> list[Event] | None:
    """The newest scan's points come again and again under new stamps."""
    last = moment.last_scan()
    return [
        replace(
            event,
            points_lidar=last.points_lidar,
            offsets_ns=last.offsets_ns,
            reflectivity=last.reflectivity,
            tags=last.tags,
        )
        if isinstance(event, LidarScan)
        else event
        for event in moment.after
    ]


def garbage_points(moment: Moment, rng: Generator) -> list[Event] | None:
    """Every return lies somewhere at random within 20 m."""

    def scatter(scan: LidarScan, hit: NDArray[np.bool_]) -> LidarScan:
        directions = rng.normal(size=scan.points_lidar.shape)
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        points = directions * rng.uniform(0.5, 20.0, (len(directions), 1))
        return _with_points(scan, np.where(hit[:, None], points, scan.points_lidar))

    return _scans(moment, scatter)


def crowd_dominates(moment: Moment, rng: Generator) -> list[Event] | None:
    """People 1.5 to 3 m away fill 330 to 360 degrees of the view and walk off at 1.5 to 2.5 m/s."""
    width = np.radians(rng.uniform(330.0, 360.0))
    heading = rng.uniform(-np.pi, np.pi)
    radius_m, speed = rng.uniform(1.5, 3.0), rng.uniform(1.5, 2.5)
    towards = np.array([np.cos(heading), np.sin(heading), 0.0])
    p_start, _, _ = moment.flight.truth(np.array([moment.t_sensor_ns]))

    def cover(scan: LidarScan, hit: NDArray[np.bool_]) -> LidarScan:
        times = scan.t_sensor_start_ns + scan.offsets_ns.astype(np.int64)
        p, q, _ = moment.flight.truth(times)
        directions = rotation.rotate(q, scan.points_lidar.astype(np.float64))
        ranges = np.linalg.norm(directions, axis=1, keepdims=True)
        directions /= np.maximum(ranges, 1e-6)
        since_s = (times - moment.t_sensor_ns)[:, None] * 1e-9
        offset = p - (p_start + towards * speed * since_s)
        # A vertical cylinder about the moving centre, seen from inside.
        a = np.einsum("ij,ij->i", directions[:, :2], directions[:, :2])
        b = np.einsum("ij,ij->i", directions[:, :2], offset[:, :2])
        c = np.einsum("ij,ij->i", offset[:, :2], offset[:, :2]) - radius_m**2
        distance = (-b + np.sqrt(np.maximum(b * b - a * c, 0.0))) / np.maximum(a, 1e-6)
        azimuth = np.arctan2(directions[:, 1], directions[:, 0]) - heading
        seen = np.abs(np.arctan2(np.sin(azimuth), np.cos(azimuth))) < 0.5 * width
        covered = hit & seen & (distance > 0.5) & (distance < ranges[:, 0]) & (c < 0.0)
        noisy = distance + rng.normal(0.0, 0.01, len(distance))
        scaled = scan.points_lidar / np.maximum(ranges, 1e-6) * noisy[:, None]
        return _with_points(scan, np.where(covered[:, None], scaled, scan.points_lidar))

    return _scans(moment, cover)


def mount_slipped(moment: Moment, rng: Generator) -> list[Event] | None:
    """The sensor, with its chip, turns by 5 to 15 degrees on its mount within 30 ms."""
    axis, angle = _direction(rng), np.radians(rng.uniform(5.0, 15.0))

    def slipped(t_ns: NDArray[np.int64]) -> FloatArray:
        """Return how far the sensor has turned (n,), rad: no jerk at either end."""
        share = np.clip((t_ns - moment.t_sensor_ns) / _SLIP_NS, 0.0, 1.0)
        return np.asarray(angle * share**3 * (10.0 - 15.0 * share + 6.0 * share**2))

    def turn(scan: LidarScan, hit: NDArray[np.bool_]) -> LidarScan:
        times = scan.t_sensor_start_ns + scan.offsets_ns.astype(np.int64)
        back = rotation.exp(-axis * slipped(times)[:, None])
        return _with_points(scan, rotation.rotate(back, scan.points_lidar.astype(np.float64)))

    events: list[Event] = []
    before_ns = moment.t_sensor_ns
    for event in _scans(moment, turn):
        if isinstance(event, ImuSample):
            now, then = slipped(np.array([event.t_sensor_ns, before_ns]))
            rate = axis * (now - then) / ((event.t_sensor_ns - before_ns) * 1e-9)
            back = rotation.exp(-axis * now)
            before_ns = event.t_sensor_ns
            event = replace(
                event,
                gyro_imu=rotation.rotate(back, event.gyro_imu) + rate,
                accel_imu=rotation.rotate(back, event.accel_imu),
            )
        events.append(event)
    return events


def kidnapped(moment: Moment, rng: Generator) -> list[Event] | None:
    """The scans go on from another place of the flight, 1 to 5 m away."""
    scans = [event for event in moment.flight.events if isinstance(event, LidarScan)]
    times = np.array([scan.t_sensor_end_ns for scan in scans], dtype=np.int64)
    p, _, _ = moment.flight.truth(times)
    here, _, _ = moment.flight.truth(np.array([moment.t_sensor_ns]))
    distance = np.linalg.norm(p - here, axis=1)
    count = sum(isinstance(event, LidarScan) for event in moment.after)
    known = np.arange(len(scans)) < len(scans) - count
    there = np.nonzero((distance > 1.0) & (distance < 5.0) & known)[0]
    if len(there) == 0:
        return None
    place = int(rng.choice(there))
    events: list[Event] = []
    for event in moment.after:
        if isinstance(event, LidarScan):
            other = scans[place]
            place += 1
            event = replace(
                event,
                points_lidar=other.points_lidar,
                offsets_ns=other.offsets_ns,
                reflectivity=other.reflectivity,
                tags=other.tags,
            )
        events.append(event)
    return events


def scan_stamps_shifted(moment: Moment, rng: Generator) -> list[Event] | None:
    """The stamps of the scans move by 50 to 100 ms against those of the IMU."""
    shift_ns = int(rng.choice([-1, 1])) * seconds_to_ns(float(rng.uniform(0.05, 0.1)))
    return [
        _restamped(event, shift_ns, 0) if isinstance(event, LidarScan) else event for event in moment.after
    ]


def sensor_clock_jumps(moment: Moment, rng: Generator) -> list[Event] | None:
    """The sensor's clock is set by seconds, forth or back, as a time source does when it appears."""
    shift_ns = int(rng.choice([-1, 1])) * seconds_to_ns(float(rng.uniform(1.0, 100.0)))
    return [_restamped(event, shift_ns, -shift_ns) for event in moment.after]


def only_ground_left(moment: Moment, rng: Generator) -> list[Event] | None:
    """Everything but a plane below vanishes: nothing tells horizontal motion and heading any more."""
    floor_m = -float(moment.flight.p_world[0, 2])

    def flatten(scan: LidarScan, hit: NDArray[np.bool_]) -> LidarScan:
        times = scan.t_sensor_start_ns + scan.offsets_ns.astype(np.int64)
        p, q, _ = moment.flight.truth(times)
        ranges = np.linalg.norm(scan.points_lidar, axis=1).astype(np.float64)
        directions_lidar = scan.points_lidar / np.maximum(ranges, 1e-6)[:, None]
        height_m = (p + rotation.rotate(q, T_BODY_LIDAR.p))[:, 2] - floor_m
        down = -rotation.rotate(q, rotation.rotate(T_BODY_LIDAR.q, directions_lidar))[:, 2]
        seen = down > height_m / _GROUND_RANGE_M
        to_ground_m = height_m / np.maximum(down, 1e-6) + rng.normal(0.0, 0.01, len(down))
        moved = np.where((hit & seen)[:, None], directions_lidar * to_ground_m[:, None], scan.points_lidar)
        return _only(_with_points(scan, moved), ~hit | seen)

    return _scans(moment, flatten)


FAILURES: dict[str, Injection] = {
    "IMU stops": imu_stops,
    "LiDAR stops": lidar_stops,
    "LiDAR blocked": lidar_blocked,
    "IMU frozen": imu_frozen,
    "IMU saturated": imu_saturated,
    "gyro bias step": gyro_bias_step,
    "accelerometer bias step": accel_bias_step,
    "gyro axis wrong": gyro_axis_wrong,
    "accelerometer axis wrong": accel_axis_wrong,
    "scan repeated": scan_repeated,
    "garbage points": garbage_points,
    "crowd dominates": crowd_dominates,
    "mount slipped": mount_slipped,
    "kidnapped": kidnapped,
    "scan stamps shifted": scan_stamps_shifted,
    "sensor clock jumps": sensor_clock_jumps,
    "only ground left": only_ground_left,
}
"""Every failure by name."""


def lose_packets(events: Sequence[Event], share: float, packet_ns: int, rng: Generator) -> list[Event]:
    """Return the events as they arrive when a share of all packets does not.

    Args:
        events: of a flight.
        share: of packets lost, each by itself; an IMU sample is one packet.
        packet_ns: time that one packet of points covers.
        rng: decides which.
    """
    kept: list[Event] = []
    for event in events:
        if isinstance(event, ImuSample):
            if rng.uniform() >= share:
                kept.append(event)
            continue
        packet = event.offsets_ns // packet_ns
        arrived = rng.uniform(size=event.packets_expected) >= share
        scan = _only(event, arrived[np.minimum(packet, event.packets_expected - 1)])
        kept.append(replace(scan, packets=int(arrived.sum())))
    return kept


def _scans(moment: Moment, change: Callable[[LidarScan, NDArray[np.bool_]], LidarScan]) -> list[Event]:
    """Change the scans after a failure; `change` learns which points were fired after it."""
    events: list[Event] = []
    for event in moment.after:
        if isinstance(event, LidarScan):
            times = event.t_sensor_start_ns + event.offsets_ns.astype(np.int64)
            event = change(event, times > moment.t_sensor_ns)
        events.append(event)
    return events


def _samples(
    moment: Moment, change: Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]
) -> list[Event]:
    events: list[Event] = []
    for event in moment.after:
        if isinstance(event, ImuSample):
            gyro_imu, accel_imu = change(event.gyro_imu, event.accel_imu)
            event = replace(event, gyro_imu=gyro_imu, accel_imu=accel_imu)
        events.append(event)
    return events


def _only(scan: LidarScan, keep: NDArray[np.bool_]) -> LidarScan:
    return replace(
        scan,
        points_lidar=scan.points_lidar[keep],
        offsets_ns=scan.offsets_ns[keep],
        reflectivity=scan.reflectivity[keep],
        tags=scan.tags[keep],
    )


def _with_points(scan: LidarScan, points_lidar: FloatArray) -> LidarScan:
    return replace(scan, points_lidar=np.ascontiguousarray(points_lidar, dtype=np.float32))


def _restamped(event: Event, shift_ns: int, offset_shift_ns: int) -> Event:
    if isinstance(event, ImuSample):
        return replace(event, t_sensor_ns=event.t_sensor_ns + shift_ns)
    return replace(
        event,
        t_sensor_start_ns=event.t_sensor_start_ns + shift_ns,
        t_sensor_end_ns=event.t_sensor_end_ns + shift_ns,
        clock_offset_ns=event.clock_offset_ns + offset_shift_ns,
    )


def _direction(rng: Generator) -> FloatArray:
    vector = rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector))
