"""What counts as a jump of the pose, and what follows from one."""

from dataclasses import replace

import numpy as np
import pytest

from companion.geometry import rotation
from companion.messages import Odometry, OdometryStatus, VehicleState
from companion.safety.pose_gate import PoseGate
from companion.safety.settings import SafetySettings
from tests.safety.test_checks import ODOMETRY, VEHICLE

MS = 1_000_000
STEP_NS = 5 * MS


class Path:
    """Odometry at 200 Hz along x, as true as its velocity says."""

    def __init__(self, speed: float = 2.0) -> None:
        self.now = replace(ODOMETRY, p_map=np.zeros(3), v_map=np.array([speed, 0.0, 0.0]))
        self.vehicle: VehicleState | None = replace(VEHICLE, v_map=self.now.v_map)
        self.gate = PoseGate(SafetySettings())

    def step(self, by: tuple[float, float, float] = (0.0, 0.0, 0.0), **changes: object) -> Odometry:
        """Go on for 5 ms and jump by metres on top; return what is admitted."""
        p_map = self.now.p_map + self.now.v_map * STEP_NS * 1e-9 + np.array(by)
        self.now = replace(self.now, t_ns=self.now.t_ns + STEP_NS, p_map=p_map, **changes)  # type: ignore[arg-type]
        if self.vehicle is not None:
            self.vehicle = replace(self.vehicle, t_ns=self.now.t_ns, t_local_ns=self.now.t_ns - STEP_NS)
        return self.gate.admit(self.now, self.vehicle)


def test_flight_at_speed_passes_unchanged() -> None:
    path = Path(speed=5.0)
    assert all(path.step() is path.now for _ in range(100))


def test_a_step_that_px4s_velocity_does_not_explain_is_kept_out_and_named() -> None:
    path = Path()
    path.step()
    admitted = path.step(by=(0.0, 1.2, 0.0))
    assert admitted.status is OdometryStatus.LOST
    assert admitted.quality == 0
    assert admitted.reason == "pose jumped by 1.2 m"
    assert path.gate.withholds


def test_after_half_a_second_without_further_jumps_poses_pass_in_a_new_map() -> None:
    path = Path()
    path.step()
    path.step(by=(1.0, 0.0, 0.0))
    admitted = [path.step() for _ in range(100)]
    assert [entry.status for entry in admitted[:99]] == [OdometryStatus.LOST] * 99
    assert admitted[99].status is OdometryStatus.TRACKING
    assert admitted[99].reset_counter == 1
    assert path.gate.counted(path.now).reset_counter == 1


def test_jumps_in_a_row_are_one_event_and_prolong_it() -> None:
    path = Path()
    path.step()
    path.step(by=(1.0, 0.0, 0.0))
    for _ in range(50):
        path.step()
    path.step(by=(-1.0, 0.0, 0.0))
    assert path.gate.jumps == 1
    assert [path.step().status for _ in range(99)] == [OdometryStatus.LOST] * 99


def test_a_reset_that_the_odometry_admits_passes() -> None:
    path = Path()
    path.step()
    assert path.step(by=(3.0, 0.0, 0.0), reset_counter=1) is path.now


def test_a_turn_that_the_rate_does_not_explain_is_a_jump() -> None:
    path = Path()
    path.step()
    assert path.step(q_map_body=rotation.from_yaw(0.3)).reason == "pose jumped by 17 deg"
    turning = Path()
    turning.step(omega_body=np.array([0.0, 0.0, 4.0]))
    assert turning.step(q_map_body=rotation.from_yaw(0.02)).status is OdometryStatus.TRACKING


@pytest.mark.parametrize("v_px4", [(0.0, 0.0, 0.0), (-2.0, 0.0, 0.0), (40.0, 0.0, 0.0)])
def test_an_autopilot_that_disagreed_before_does_not_keep_the_odometry_out(
    v_px4: tuple[float, float, float],
) -> None:
    path = Path()
    assert path.vehicle is not None
    path.vehicle = replace(path.vehicle, v_map=np.array(v_px4))
    assert all(path.step() is path.now for _ in range(200))
    assert path.step(by=(0.5, 0.0, 0.0)).status is OdometryStatus.LOST


def test_without_autopilot_the_odometrys_own_velocity_decides() -> None:
    path = Path()
    path.vehicle = None
    assert path.step() is path.now
    assert path.step(by=(0.0, 0.0, 0.5)).status is OdometryStatus.LOST


def test_after_a_long_silence_there_is_nothing_to_compare_with() -> None:
    path = Path()
    path.step()
    path.now = replace(path.now, t_ns=path.now.t_ns + 300 * MS)
    assert path.step(by=(2.0, 0.0, 0.0)) is path.now


def test_lost_odometry_passes_as_it_is_and_is_no_reference() -> None:
    path = Path()
    path.step()
    lost = path.step(status=OdometryStatus.LOST, quality=0, reason="diverged")
    assert lost.reason == "diverged"
    assert path.step(by=(4.0, 0.0, 0.0), status=OdometryStatus.TRACKING, reason="").status is (
        OdometryStatus.TRACKING
    )
