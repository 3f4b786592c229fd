from collections.abc import Callable

import numpy as np
import pytest

from companion.messages import FloatArray, ImuSample
from companion.perception.odometry import inertial_monitor_kernels as kernels
from companion.perception.odometry.inertial_monitor import InertialMonitor
from companion.perception.odometry.settings import OdometrySettings

PERIOD_NS = 5_000_000
Change = Callable[[int, FloatArray, FloatArray], tuple[FloatArray, FloatArray]]


def _samples(count: int, change: Change | None = None, period_ns: int = PERIOD_NS) -> list[ImuSample]:
    """Hover with the shaking of running motors."""
    rng = np.random.default_rng(4)
    samples = []
    for i in range(count):
        gyro = rng.normal(0.0, 0.02, 3)
        accel = np.array([0.0, 0.0, 9.81]) + rng.normal(0.0, 0.8, 3)
        if change is not None:
            gyro, accel = change(i, gyro, accel)
        samples.append(ImuSample(period_ns * i, period_ns * i, gyro, accel))
    return samples


def _findings(samples: list[ImuSample]) -> list[str]:
    monitor = InertialMonitor(OdometrySettings())
    return [monitor.observe(sample) for sample in samples]


def test_a_shaken_chip_is_healthy() -> None:
    assert set(_findings(_samples(2000))) == {""}


def test_a_fifth_of_all_samples_may_be_missing() -> None:
    rng = np.random.default_rng(1)
    kept = [sample for sample in _samples(4000) if rng.uniform() > 0.2]
    assert set(_findings(kept)) == {""}


def test_turning_as_hard_as_a_vehicle_can_is_no_jolt() -> None:
    def swing(i: int, gyro: FloatArray, accel: FloatArray) -> tuple[FloatArray, FloatArray]:
        return gyro + np.array([2.0 * np.sin(40.0 * i * 5e-3), 0.0, 0.0]), accel  # up to 80 rad/s^2

    assert set(_findings(_samples(1000, swing))) == {""}


def test_samples_that_repeat_are_noticed_within_thirty_milliseconds() -> None:
    samples = _samples(300)
    stuck = samples[199]
    samples[200:] = [ImuSample(s.t_ns, s.t_sensor_ns, stuck.gyro_imu, stuck.accel_imu) for s in samples[200:]]
    findings = _findings(samples)
    first = next(i for i, finding in enumerate(findings) if finding)
    assert 200 <= first <= 205
    assert findings[first] == "IMU frozen: its values repeat"


def test_one_stuck_axis_is_noticed_within_a_quarter_of_a_second() -> None:
    def stick(i: int, gyro: FloatArray, accel: FloatArray) -> tuple[FloatArray, FloatArray]:
        return (gyro, np.array([0.1, accel[1], accel[2]])) if i >= 200 else (gyro, accel)

    findings = _findings(_samples(300, stick))
    assert findings.index("IMU frozen: its values repeat") < 250


def test_one_saturated_sample_is_a_knock_and_three_are_a_fault() -> None:
    def saturate(last: int) -> Change:
        def change(i: int, gyro: FloatArray, accel: FloatArray) -> tuple[FloatArray, FloatArray]:
            return (gyro, np.array([80.0, 0.0, 9.8])) if 200 <= i < last else (gyro, accel)

        return change

    assert set(_findings(_samples(300, saturate(201)))) == {""}
    assert "IMU saturated" in _findings(_samples(300, saturate(203)))


def test_a_gap_is_told_with_its_length() -> None:
    samples = _samples(300)
    del samples[200:220]
    assert _findings(samples)[200] == "IMU interrupted for 0.10 s"


@pytest.mark.parametrize(("period_ns", "told"), [(11_000_000, "91 Hz"), (2_000_000, "500 Hz")])
def test_a_rate_far_from_the_nominal_one_is_told(period_ns: int, told: str) -> None:
    findings = _findings(_samples(300, period_ns=period_ns))
    assert findings[-1] == f"IMU comes at {told}, not 200"


def test_a_mount_that_slips_by_five_degrees_is_a_jolt() -> None:
    def slip(i: int, gyro: FloatArray, accel: FloatArray) -> tuple[FloatArray, FloatArray]:
        return (
            (gyro + np.array([0.0, np.radians(5.0) / 0.03, 0.0]), accel) if 200 <= i < 206 else (gyro, accel)
        )

    findings = _findings(_samples(300, slip))
    first = next(i for i, finding in enumerate(findings) if finding)
    assert 200 <= first <= 203
    assert findings[first].startswith("jolt")


def test_a_relabelled_clock_is_no_gap() -> None:
    monitor = InertialMonitor(OdometrySettings())
    samples = _samples(200)
    for sample in samples[:100]:
        monitor.observe(sample)
    monitor.relabel(90_000_000_000)
    for s in samples[100:]:
        later = ImuSample(s.t_ns, s.t_sensor_ns + 90_000_000_000, s.gyro_imu, s.accel_imu)
        assert monitor.observe(later) == ""


def test_the_kernel_decides_as_its_readable_form() -> None:
    """The same rules over the whole history with NumPy, for a chip with every fault in turn."""

    def faults(i: int, gyro: FloatArray, accel: FloatArray) -> tuple[FloatArray, FloatArray]:
        if 100 <= i < 108:
            return np.full(3, 0.5), np.full(3, 9.0)
        if 150 <= i < 154:
            return gyro, np.array([80.0, 0.0, 9.8])
        if 220 <= i < 226:
            return gyro + 4.0, accel
        return gyro, accel

    samples = _samples(300, faults)
    limits = np.array([0.06, 1.0 / 380.0, 1.9 / 200.0, 150.0, 34.0, 78.0])
    memory = np.zeros(kernels.MEMORY_SIZE)
    values = np.array([np.concatenate([s.gyro_imu, s.accel_imu]) for s in samples])
    share = 0.0
    for i, sample in enumerate(samples):
        found = kernels.watch(sample.gyro_imu, sample.accel_imu, 5e-3 if i else 0.0, limits, memory)
        saturated = bool((np.abs(values[i]) >= np.repeat(limits[4:], 3)).any())
        share += 0.05 * (saturated - share)
        frozen = i >= 5 and bool((values[i - 5 : i + 1] == values[i]).all())
        newest = values[max(0, i - 3) : i + 1, :3]
        change = newest[-2:].mean(axis=0) - newest[:2].mean(axis=0)
        jolted = i > 3 and float(np.linalg.norm(change)) > 150.0 * 0.01
        expected = kernels.HEALTHY
        if frozen:
            expected = kernels.FROZEN
        elif share > 0.12:
            expected = kernels.SATURATED
        elif jolted:
            expected = kernels.JOLTED
        assert found == expected, i
