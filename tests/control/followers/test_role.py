import numpy as np
import pytest

from companion.clock import seconds_to_ns
from companion.control.followers.role import FollowerRole
from companion.control.followers.settings import FollowerSettings
from companion.geometry import rotation
from companion.messages import (
    FloatArray,
    NeighbourTrack,
    NeighbourTracks,
    Odometry,
    OdometryStatus,
    RegisteredScan,
    Surroundings,
)
from companion.perception.neighbours import NeighbourSettings, NeighbourView
from companion.perception.occupancy import GridSettings, ObstacleGrid

START_NS = 5_000_000_000
TICK_NS = 20_000_000


def role(settings: FollowerSettings | None = None, *, compensate: bool = True) -> FollowerRole:
    neighbours = NeighbourSettings(compensate_latency=compensate)
    free = np.full((72, 12), np.inf)
    return FollowerRole(
        settings or FollowerSettings(), NeighbourView(neighbours), ObstacleGrid(GridSettings()), free
    )


def odometry(t_ns: int, yaw: float = 0.0, **changes: object) -> Odometry:
    values: dict[str, object] = {
        "t_ns": t_ns,
        "t_sensor_ns": t_ns,
        "p_map": np.array([0.0, 0.0, 1.5]),
        "q_map_body": rotation.from_yaw(yaw),
        "v_map": np.zeros(3),
        "omega_body": np.zeros(3),
        "covariance_pose": np.eye(6) * 1e-6,
        "covariance_velocity": np.eye(3) * 1e-6,
        "quality": 90,
        "reset_counter": 0,
        "status": OdometryStatus.TRACKING,
        **changes,
    }
    return Odometry(**values)  # type: ignore[arg-type]


def track(p_map: tuple[float, float, float], t_ns: int, v_map: FloatArray | None = None) -> NeighbourTrack:
    v = np.zeros(3) if v_map is None else v_map
    return NeighbourTrack(1, np.array(p_map), v, np.eye(6) * 1e-4, 0, t_ns, 20, 0.5, True)


def show(
    follower: FollowerRole,
    t_ns: int,
    sequence: int,
    *tracks: NeighbourTrack,
    points: FloatArray | None = None,
    own: Odometry | None = None,
) -> None:
    """Let a follower see tracks and points in one scan."""
    cloud = np.zeros((0, 3)) if points is None else points
    number = len(cloud)
    follower.meet(NeighbourTracks(t_ns, sequence, tracks))
    follower.observe(
        RegisteredScan(
            t_ns,
            sequence,
            cloud.astype(np.float32),
            np.zeros(number, np.uint8),
            own or odometry(t_ns),
            np.zeros(number, np.int32),
        )
    )


def fly(follower: FollowerRole, t_ns: int, ticks: int, yaw: float = 0.0) -> FloatArray:
    """Decide so many times from `t_ns` on; return the last velocity in the map."""
    for tick in range(ticks):
        now = t_ns + tick * TICK_NS
        v_map = follower.decide(odometry(now, yaw), now).command.v_map
    return v_map


def test_it_flies_to_its_neighbour_in_the_map_whatever_its_heading() -> None:
    for yaw in (0.0, 1.2, -2.9):
        follower = role()
        follower.reset(odometry(START_NS, yaw))
        show(follower, START_NS, 1, track((0.0, 4.0, 1.5), START_NS), own=odometry(START_NS, yaw))
        v_map = fly(follower, START_NS, 20, yaw)
        assert v_map[1] > 0.2
        assert abs(v_map[0]) < 1e-6


def test_its_command_rests_on_the_newest_odometry_holds_the_heading_and_never_ends() -> None:
    follower = role()
    follower.reset(odometry(START_NS))
    decision = follower.decide(odometry(START_NS - 3_000_000), START_NS)
    assert decision.command.t_ns == START_NS - 3_000_000
    assert decision.command.yaw_rate == 0.0
    assert decision.plan is None
    assert not decision.finished


def test_the_first_command_after_taking_control_is_zero() -> None:
    follower = role()
    show(follower, START_NS, 1, track((3.0, 1.0, 1.8), START_NS))
    for _ in range(2):
        follower.reset(odometry(START_NS))
        assert follower.decide(odometry(START_NS), START_NS).command.v_map.tolist() == [0.0, 0.0, 0.0]
        assert fly(follower, START_NS, 20).any()


def test_with_nobody_in_view_it_stays_and_returns_to_the_recovery_height_slowly() -> None:
    follower = role()
    follower.reset(odometry(START_NS))
    assert not fly(follower, START_NS, 50).any()
    v_map = fly(follower, START_NS + seconds_to_ns(1.1), 50)
    assert v_map[:2].tolist() == [0.0, 0.0]
    assert -0.6 < v_map[2] < -0.3


def test_an_obstacle_in_the_scan_holds_it_back() -> None:
    angle, height = np.meshgrid(np.linspace(-0.5, 0.5, 40), np.linspace(1.2, 1.8, 20))
    wall = np.column_stack([np.full(angle.size, 0.4), 2.0 * np.tan(angle).ravel(), height.ravel()])
    blocked, open_field = role(), role()
    for follower, points in ((blocked, wall), (open_field, None)):
        follower.reset(odometry(START_NS))
        show(follower, START_NS, 1, track((4.0, 0.0, 1.5), START_NS), points=points)
    assert fly(open_field, START_NS, 20)[0] > 0.25
    assert fly(blocked, START_NS, 20)[0] < 0.15


def test_when_the_map_jumps_it_forgets_whom_and_what_it_saw() -> None:
    follower = role()
    follower.reset(odometry(START_NS))
    show(follower, START_NS, 1, track((4.0, 0.0, 1.5), START_NS))
    assert fly(follower, START_NS, 10).any()
    jumped = odometry(START_NS, reset_counter=1)
    for tick in range(10):
        decision = follower.decide(jumped, START_NS + tick * TICK_NS)
        assert decision.command.v_map.tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("status", [OdometryStatus.INITIALISING, OdometryStatus.LOST])
def test_without_trustworthy_odometry_it_asks_for_zero(status: OdometryStatus) -> None:
    follower = role()
    follower.reset(odometry(START_NS))
    show(follower, START_NS, 1, track((4.0, 0.0, 1.5), START_NS))
    fly(follower, START_NS, 10)
    lost = odometry(START_NS, status=status)
    assert not follower.decide(lost, START_NS + TICK_NS).command.v_map.any()
    for broken in (
        odometry(START_NS, p_map=np.array([np.nan, 0.0, 0.0])),
        odometry(START_NS, q_map_body=np.array([1.0, 0.0, np.nan, 0.0])),
        odometry(START_NS, omega_body=np.array([0.0, 0.0, np.inf])),
    ):
        assert not follower.decide(broken, START_NS + TICK_NS).command.v_map.any()
    # It goes on from standstill, not from what it flew before.
    assert not follower.decide(odometry(START_NS), START_NS + 2 * TICK_NS).command.v_map.any()


def test_tracks_of_another_scan_are_not_taken_for_those_of_this_one() -> None:
    follower = role()
    follower.reset(odometry(START_NS))
    follower.meet(NeighbourTracks(START_NS, 7, (track((4.0, 0.0, 1.5), START_NS),)))
    empty = np.zeros((0, 3), np.float32)
    follower.observe(
        RegisteredScan(START_NS, 8, empty, np.zeros(0, np.uint8), odometry(START_NS), np.zeros(0, np.int32))
    )
    assert not fly(follower, START_NS, 10).any()


@pytest.mark.parametrize("method", ["pacnav", "vpf", "vpf_polar", "reynolds_apf", "lloyd"])
def test_every_law_flies(method: str) -> None:
    follower = role(FollowerSettings.model_validate({"method": method}))
    follower.reset(odometry(START_NS))
    show(follower, START_NS, 1, track((5.0, 1.0, 1.6), START_NS))
    v_map = fly(follower, START_NS, 20)
    assert np.isfinite(v_map).all()
    assert np.linalg.norm(v_map) > 0.1


def test_equal_flights_give_equal_bytes() -> None:
    def flight() -> bytes:
        rng = np.random.default_rng(4)
        follower = role()
        follower.reset(odometry(START_NS))
        commands = []
        for tick in range(60):
            t_ns = START_NS + tick * TICK_NS
            if tick % 5 == 0:
                place = (3.0 + 0.02 * tick, float(rng.normal(0.0, 0.1)), 1.5)
                show(follower, t_ns, tick, track(place, t_ns), points=rng.uniform(-3.0, 3.0, (200, 3)))
            commands.append(follower.decide(odometry(t_ns), t_ns).command.v_map.tobytes())
        return b"".join(commands)

    assert flight() == flight()


def test_what_the_law_was_given_is_told_once_for_every_scan() -> None:
    follower = role()
    now_ns = START_NS
    wall = np.array([[0.0, 3.0, 1.5], [0.0, 3.05, 1.5]])
    told: list[list[Surroundings]] = []
    for sequence in range(3):
        show(follower, now_ns, sequence, track((2.0, 0.0, 1.5), now_ns), points=wall)
        for _ in range(5):
            now_ns += TICK_NS
            remarks = follower.decide(odometry(now_ns), now_ns).remarks
            told.append([remark for remark in remarks if isinstance(remark, Surroundings)])
    assert [len(remarks) for remarks in told] == [1, 0, 0, 0, 0] * 3
    [seen] = told[5]
    assert (seen.t_ns, seen.t_scan_ns) == (START_NS + 6 * TICK_NS, START_NS + 5 * TICK_NS)
    assert seen.neighbours.states_heading[0, :3] == pytest.approx([2.0, 0.0, 0.0], abs=1e-6)
    assert seen.ranges.shape == (72, 12)
    assert seen.ranges.min() == pytest.approx(3.0, abs=1e-6)
    kept = seen.ranges.copy()
    show(follower, now_ns, 3)
    assert np.array_equal(seen.ranges, kept)
