import numpy as np
import pytest

from companion.drivers.livox_filter import PointFilter, kept_tags
from companion.drivers.livox_packets import DataType, DecodedPoints, decode_points
from companion.drivers.livox_settings import LivoxSettings, MaskBox, TagPolicy
from sitl.livox_stream import encode_points
from sitl.slots import PointSlots

BOX = MaskBox(x_min_m=-0.5, x_max_m=0.5, y_min_m=0.4, y_max_m=0.8, z_min_m=-0.2, z_max_m=0.1)


def decoded(points: np.ndarray, tags: np.ndarray) -> DecodedPoints:
    n = len(points)
    return DecodedPoints(
        points.astype(np.float32), np.zeros(n, np.uint8), tags.astype(np.uint8), np.arange(n, dtype=np.int64)
    )


def verdict(point: np.ndarray, tag: int, settings: LivoxSettings) -> str:
    """Judge one point slowly, in the order of the counters."""
    x, y, z = (float(value) for value in point)
    distance = (x * x + y * y + z * z) ** 0.5
    fields = [tag & 3, tag >> 2 & 3, tag >> 4 & 3]
    if distance == 0.0:
        return "no_return"
    if distance < settings.min_range_m:
        return "too_near"
    if distance > settings.max_range_m:
        return "too_far"
    if settings.tag_policy == "not_low" and any(field >= 2 for field in fields):
        return "low_confidence"
    if settings.tag_policy == "only_high" and any(fields):
        return "low_confidence"
    for box in settings.self_mask:
        inside_x = box.x_min_m <= x <= box.x_max_m
        inside_y = box.y_min_m <= y <= box.y_max_m
        if inside_x and inside_y and box.z_min_m <= z <= box.z_max_m:
            return "self_masked"
    return "points"


@pytest.mark.parametrize("policy", ["all", "not_low", "only_high"])
def test_each_slot_is_counted_once_and_by_the_first_reason_that_applies(policy: TagPolicy) -> None:
    settings = LivoxSettings(tag_policy=policy, max_range_m=3.0, self_mask=(BOX,))
    rng = np.random.default_rng(1)
    points = rng.uniform(-1.0, 1.0, (4_000, 3)) * rng.choice([0.0, 0.4, 1.0, 3.0], (4_000, 1))
    tags = rng.integers(0, 64, 4_000) * (rng.random(4_000) < 0.3)
    inside = rng.random(4_000) < 0.9
    point_filter = PointFilter(settings)
    kept = point_filter.keep(decoded(points, tags), inside)
    verdicts = [verdict(point, int(tag), settings) for point, tag in zip(points, tags, strict=True)]
    expected = [i for i, word in enumerate(verdicts) if word == "points" and inside[i]]
    assert kept.tolist() == expected
    counts = point_filter.counts
    assert counts.slots == inside.sum()
    for word in ("no_return", "too_near", "too_far", "low_confidence", "self_masked", "points"):
        expected_count = sum(inside[i] and verdicts[i] == word for i in range(4_000))
        assert getattr(counts, word) == expected_count
        assert expected_count > 0 or (word, policy) == ("low_confidence", "all")


@pytest.mark.parametrize("policy", ["all", "not_low", "only_high"])
def test_usual_packets_decoded_in_one_go_give_the_same_points_and_counts(policy: TagPolicy) -> None:
    settings = LivoxSettings(tag_policy=policy, max_range_m=3.0, self_mask=(BOX,))
    rng = np.random.default_rng(2)
    n = 40 * 96
    points = rng.uniform(-1.0, 1.0, (n, 3)) * rng.choice([0.0, 0.4, 1.0, 3.0, 1e9], (n, 1))
    tags = rng.integers(0, 256, n) * (rng.random(n) < 0.3)
    slots = PointSlots(1_000, points, rng.integers(0, 256, n).astype(np.uint8), tags.astype(np.uint8))
    payloads = encode_points(slots, DataType.CARTESIAN_32, 0, 0)
    packets = np.stack([np.frombuffer(payload, np.uint8) for payload in payloads])
    packets[::3, 3] ^= 37  # other spans, so other times between slots
    base_ns, period_ns = 1_200 * 5_000, 10_000_000
    slow, quick = PointFilter(settings), PointFilter(settings)
    every = decode_points(packets, base_ns)
    expected = every.chosen(slow.keep(every, (every.t_ns >= 0) & (every.t_ns < period_ns)))
    kept = quick.keep_usual(packets, base_ns, period_ns)
    assert 100 < len(kept.t_ns) < n / 2
    for name in ("points_lidar", "reflectivity", "tags", "t_ns"):
        np.testing.assert_array_equal(getattr(kept, name), getattr(expected, name))
    assert quick.counts == slow.counts


def test_the_usual_tags_of_real_recordings_are_kept_or_dropped_as_documented() -> None:
    not_low = kept_tags("not_low")
    assert [tag for tag in (0, 1, 4, 16, 5, 2, 8, 32, 6, 9, 18) if not_low[tag]] == [0, 1, 4, 16, 5]
    only_high = kept_tags("only_high")
    assert np.flatnonzero(only_high).tolist() == [0, 64, 128, 192]
    assert kept_tags("all").all()


def test_an_empty_box_is_refused() -> None:
    with pytest.raises(ValueError, match="y_min_m must be less than y_max_m"):
        MaskBox(x_min_m=0.0, x_max_m=1.0, y_min_m=1.0, y_max_m=1.0, z_min_m=0.0, z_max_m=1.0)
