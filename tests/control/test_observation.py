"""Observations against a slow reading of their contract."""

import numpy as np
import pytest

from companion.control.followers import layout_kernels as layout
from companion.control.followers.layout_kernels import EGO_V, EGO_YAW
from companion.control.observation import CONTRACTS, Contract, Observation
from companion.control.observation_kernels import describe
from companion.geometry import rotation
from companion.messages import Float32Array, FloatArray
from tests.control.followers.situations import Follower, column, drawn, free, others, own

LEVEL = np.array([0.0, 0.0, 1.0])


def observed(
    contract: Contract,
    follower: Follower,
    ego: FloatArray,
    neighbours: FloatArray,
    ranges: FloatArray,
    *,
    up: FloatArray = LEVEL,
    previous: FloatArray | None = None,
) -> tuple[Observation, FloatArray]:
    """Let the law see the situation; return the observation, in dirty memory, and the law's command."""
    command = follower.steer(ego, neighbours, ranges)
    seen = Observation(contract)
    for array in seen.inputs.values():
        array[:] = np.nan
    describe(
        contract.number, ego, up, neighbours, ranges, follower.memory, follower.parameters, command,
        np.zeros(3) if previous is None else previous,
        seen.ego[0], seen.neighbours[0], seen.grid[0], seen.memory[0],
    )  # fmt: skip
    return seen, command


def grid_of(ranges: FloatArray) -> Float32Array:
    hit = ranges < 10.0
    return np.stack([np.where(hit, 1.0 - ranges / 10.0, 0.0), hit]).astype(np.float32)


def view_of(follower: Follower, ego: FloatArray) -> FloatArray:
    """Return rows of `best-2` from what the law remembers."""
    known = int(follower.memory[layout.FLOCK_KNOWN])
    view = follower.memory[layout.FLOCK_VIEW :][: known * layout.FLOCK_VIEW_SIZE].reshape(
        known, layout.FLOCK_VIEW_SIZE
    )[:, :6]
    rows = np.zeros((12, 8))
    for row, (x, y, z, vx, vy, trust) in zip(rows, view, strict=False):
        distance = np.linalg.norm([x, y, z])
        near = 0.4 / max(float(distance), 0.4)
        row[:] = x / 5, y / 5, z, (vx - ego[EGO_V]) / 2, (vy - ego[EGO_V + 1]) / 2, trust, 1, near
    return rows


def surroundings_of(follower: Follower, ego: FloatArray) -> FloatArray:
    """Return the nearness of obstacles in each direction, as the law's memory has them."""
    memory, gains = follower.memory, follower.settings.flock
    nearness = np.maximum(1.0 - memory[layout.FLOCK_COLUMNS :][:72] / 5.0, 0.0)
    points = memory[layout.FLOCK_POINTS :][: 48 * 4].reshape(48, 4)
    for left, x, y, z in points:
        if left <= 0.0 or not -gains.band_below_m <= ego[2] - z <= gains.band_above_m:
            continue
        dx, dy, _ = rotation.rotate(rotation.from_yaw(-ego[EGO_YAW]), [x - ego[0], y - ego[1], 0.0])
        index = int(np.degrees(np.arctan2(dy, dx)) % 360.0 // 5.0) % 72
        nearness[index] = max(nearness[index], 1.0 - np.hypot(dx, dy) / 5.0)
    return nearness


def test_the_contracts_are_as_published() -> None:
    assert {name: contract.inputs for name, contract in CONTRACTS.items()} == {
        "paper-1": {"ego": (7,), "neighbours": (6, 7), "grid": (2, 72, 12)},
        "best-2": {"ego": (14,), "neighbours": (12, 8), "grid": (2, 72, 12), "memory": (72,)},
    }
    for contract in CONTRACTS.values():
        arrays = Observation(contract, 3).inputs
        assert {name: values.shape for name, values in arrays.items()} == {
            name: (3, *shape) for name, shape in contract.inputs.items()
        }
        assert all(values.dtype == np.float32 for values in arrays.values())


def test_the_grid_is_nearness_and_hits() -> None:
    ranges = free()
    ranges[0, 0], ranges[71, 11], ranges[30, 5], ranges[31, 5] = 2.5, 0.0, 9.999, 10.0
    for contract in CONTRACTS.values():
        seen, _ = observed(contract, Follower("flock"), own(), others(), ranges)
        assert seen.grid[0, :, 0, 0].tolist() == [0.75, 1.0]
        assert seen.grid[0, :, 71, 11].tolist() == [1.0, 1.0]
        assert seen.grid[0, 1].sum() == 3.0
        np.testing.assert_array_equal(seen.grid[0], grid_of(ranges))


def test_the_papers_own_state_is_velocity_and_attitude_without_heading() -> None:
    rng = np.random.default_rng(5)
    for _ in range(50):
        roll, pitch, yaw = rng.uniform(-0.6, 0.6), rng.uniform(-0.6, 0.6), rng.uniform(-3.0, 3.0)
        q_heading_body = rotation.multiply(rotation.exp([0.0, pitch, 0.0]), rotation.exp([roll, 0.0, 0.0]))
        q_map_body = rotation.multiply(rotation.from_yaw(yaw), q_heading_body)
        assert rotation.yaw_of(q_map_body) == pytest.approx(yaw)
        v = rng.uniform(-2.0, 2.0, 3)
        ego = own(v=(v[0], v[1], v[2]), yaw=yaw)
        up = np.asarray(rotation.rotate(q_heading_body, [0.0, 0.0, 1.0]))
        seen, _ = observed(CONTRACTS["paper-1"], Follower("lloyd"), ego, others(), free(), up=up)
        np.testing.assert_allclose(seen.ego[0], [*v / 2.0, *q_heading_body], atol=1e-6)


def test_the_papers_neighbours_are_those_in_sight_nearest_first() -> None:
    rows = others((1.0, -2.0, 0.5, 1.0, 0.5, -1.0), (4.0, 0.0, 0.0))
    seen, _ = observed(CONTRACTS["paper-1"], Follower("flock"), own(v=(1.0, 0.0, 0.0)), rows, free())
    assert seen.neighbours[0, 0].tolist() == pytest.approx([0.1, -0.2, 0.05, 0.5, 0.25, -0.5, 1.0])
    assert seen.neighbours[0, 1].tolist() == pytest.approx([0.4, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    assert not seen.neighbours[0, 2:].any()
    # Fewer rows are given, or more.
    for count in (1, 12):
        many = np.zeros((count, 8))
        many[0] = rows[0]
        seen, _ = observed(CONTRACTS["paper-1"], Follower("flock"), own(), many, free())
        assert seen.neighbours[0, :, 6].tolist() == [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]


def test_the_best_own_state_by_hand() -> None:
    follower = Follower("flock")
    ego = own(p=(3.0, 4.0, 1.5), v=(0.5, -0.25, 0.125), yaw=1.0, alone=0.5)
    up, previous = np.array([0.1, -0.2, 0.97]), np.array([0.2, 0.4, -0.6])
    seen, command = observed(
        CONTRACTS["best-2"], follower, ego, others((2.0, 1.0, 0.1)), free(), up=up, previous=previous
    )
    wanted = [0.25, -0.125, 0.0625, 0.1, -0.2, -0.25, 0.25, 0.1, 0.2, -0.3, *command / 2.0, 0.1]
    np.testing.assert_allclose(seen.ego[0], wanted, rtol=1e-6)
    lonely = own(p=(0.0, 0.0, 30.0), alone=np.inf)
    seen, _ = observed(CONTRACTS["best-2"], Follower("flock"), lonely, others(), free())
    assert seen.ego[0, 5:7].tolist() == [2.0, 1.0]
    assert seen.ego[0, 13] == 0.0
    assert not seen.neighbours.any()


def test_the_best_observation_shows_what_the_law_remembers() -> None:
    rng = np.random.default_rng(8)
    follower = Follower("flock")
    remembered = 0
    for step in range(200):
        ego, rows, ranges = drawn(rng)
        # A flight, not a row of leaps: what was seen before is still near.
        ego[0:3] = 0.05 * step, 0.3 * np.sin(0.1 * step), 1.5
        seen, _ = observed(CONTRACTS["best-2"], follower, ego, rows if step % 3 == 0 else others(), ranges)
        np.testing.assert_allclose(seen.neighbours[0], view_of(follower, ego), atol=1e-6)
        np.testing.assert_allclose(seen.memory[0], surroundings_of(follower, ego), atol=1e-6)
        np.testing.assert_array_equal(seen.grid[0], grid_of(ranges).astype(np.float32))
        remembered += bool((seen.neighbours[0, :, 5] < 0.99).any() and seen.neighbours[0, :, 6].any())
    assert remembered > 50


def test_an_obstacle_out_of_sight_is_still_shown_where_it_was() -> None:
    follower = Follower("flock")
    contract = CONTRACTS["best-2"]
    seen, _ = observed(contract, follower, own(), others(), column(free(), 2.0, 1.0))
    assert seen.memory[0, 0] == pytest.approx(0.8, abs=0.01)
    assert np.count_nonzero(seen.memory) == 1
    # A quarter turn to the left, and a step nearer to it.
    seen, _ = observed(contract, follower, own(p=(0.5, 0.0, 1.5), yaw=np.pi / 2), others(), free())
    # The column's centre is 2.5 degrees to the left of where it was ahead.
    angle = np.arctan2(np.sin(np.radians(2.5)), np.cos(np.radians(2.5)) - 0.5) - np.pi / 2
    assert seen.memory[0].argmax() == np.degrees(angle) % 360.0 // 5.0
    assert seen.memory[0].max() == pytest.approx(0.9, abs=0.01)


def test_equal_situations_give_equal_bytes() -> None:
    def run() -> bytes:
        rng, follower = np.random.default_rng(2), Follower("flock")
        flown = []
        for _ in range(20):
            seen, _ = observed(CONTRACTS["best-2"], follower, *drawn(rng))
            flown.append(b"".join(values.tobytes() for values in seen.inputs.values()))
        return b"".join(flown)

    assert run() == run()
