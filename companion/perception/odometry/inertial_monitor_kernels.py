"""What one IMU sample says about the chip: watched for every sample, so compiled.

`memory` carries what is remembered between samples: 0-5 the last values, 6-11 for how many samples each
axis has repeated itself, 12 for how many all six have, 13 smoothed share of saturated samples, 14
smoothed interval in seconds, 15-17 the gyro of the sample before the last, 18-20 of the one before that,
21 number of samples seen, 22 the last interval.
"""

from companion.compiled import compiled
from companion.messages import FloatArray

MEMORY_SIZE = 23
HEALTHY, FROZEN, SATURATED, INTERRUPTED, WRONG_RATE, JOLTED = range(6)

_ALL_REPEATED = 5  # white noise of six axes never repeats together; six equal samples are no chance
_ONE_REPEATED = 40  # one axis of coarse steps may repeat itself for a while at rest, not for 0.2 s
_SATURATED_SHARE = 0.12  # three of the newest samples: more than one knock
_SMOOTHING = 0.05  # over twenty samples, 0.1 s at 200 Hz
_SETTLED = 40  # samples after which the smoothed interval means something


@compiled("int64(float64[::1], float64[::1], float64, float64[::1], float64[::1])")
def watch(
    gyro_imu: FloatArray,
    accel_imu: FloatArray,
    interval_s: float,
    limits: FloatArray,
    memory: FloatArray,
) -> int:
    """Take one sample into the memory and say what is wrong, the worst first.

    Args:
        gyro_imu: (3,) rad/s.
        accel_imu: (3,) m/s^2.
        interval_s: since the sample before; 0 for the first one.
        limits: (6,) longest interval, smallest and largest smoothed interval in seconds, largest angular
            acceleration in rad/s^2, rate in rad/s and specific force in m/s^2 that count as saturated.
        memory: (23,) see above; zero at the start.
    """
    seen = memory[21]
    jolted = False
    if interval_s > 0.0:
        memory[14] += _SMOOTHING * (interval_s - memory[14]) if seen > 1.0 else interval_s
        # Means of two samples, two samples apart: shaking at half the sampling rate cancels.
        if seen > 3.0 and interval_s + memory[22] < 4.0 * memory[14]:
            square = 0.0
            for axis in range(3):
                change = gyro_imu[axis] + memory[axis] - memory[15 + axis] - memory[18 + axis]
                square += change * change
            jolted = square > (4.0 * limits[3] * memory[14]) ** 2
    for axis in range(3):
        memory[18 + axis] = memory[15 + axis]
        memory[15 + axis] = memory[axis]
    equal = 0
    longest = 0.0
    saturated = 0.0
    for axis in range(6):
        value = gyro_imu[axis] if axis < 3 else accel_imu[axis - 3]
        if abs(value) >= (limits[4] if axis < 3 else limits[5]):
            saturated = 1.0
        if seen > 0.0 and value == memory[axis]:
            memory[6 + axis] += 1.0
            equal += 1
        else:
            memory[6 + axis] = 0.0
        longest = max(longest, memory[6 + axis])
        memory[axis] = value
    memory[12] = memory[12] + 1.0 if equal == 6 else 0.0
    memory[13] += _SMOOTHING * (saturated - memory[13])
    memory[22] = interval_s
    memory[21] = seen + 1.0
    if memory[12] >= _ALL_REPEATED or longest >= _ONE_REPEATED:
        return FROZEN
    if memory[13] > _SATURATED_SHARE:
        return SATURATED
    if interval_s > limits[0]:
        return INTERRUPTED
    if seen > _SETTLED and not limits[1] <= memory[14] <= limits[2]:
        return WRONG_RATE
    return JOLTED if jolted else HEALTHY
