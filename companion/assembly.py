"""Which parts fly, decided by the profile."""

import numpy as np

from companion.clock import Clock
from companion.config import Profile
from companion.control.action import Pilot
from companion.control.followers.role import FollowerRole
from companion.control.followers.settings import FollowerSettings
from companion.control.leader.planner import LeaderPlanner
from companion.perception.neighbours import NeighbourView
from companion.perception.occupancy import ObstacleGrid
from companion.perception.odometry.external import ExternalMotionEstimator
from companion.perception.odometry.lio import LidarInertialOdometry
from companion.perception.tracking.tracker import NeighbourTracker
from companion.pipeline import Estimator, Pipeline, Role

_PLANNER_SEED = 0


def assemble(profile: Profile, clock: Clock | None = None) -> Pipeline:
    """Build the pipeline of one vehicle.

    Args:
        profile: of the vehicle.
        clock: of the host, for what must not be waited for in flight; without one everything is, and equal
            events have equal consequences.

    Raises:
        ModelError: if the profile names a learned model that cannot be flown.
    """
    return Pipeline(
        estimator=_estimator(profile),
        tracker=NeighbourTracker(profile.tracking, profile.vehicle.T_body_lidar),
        role=_role(profile, clock),
        safety=profile.safety,
        authorisation_sources=profile.authorisation.sources,
    )


def _estimator(profile: Profile) -> Estimator:
    vehicle = profile.vehicle
    if profile.odometry.source == "external":
        return ExternalMotionEstimator(profile.odometry, vehicle.T_body_lidar, vehicle.T_lidar_imu)
    return LidarInertialOdometry(profile.odometry, vehicle.T_body_lidar, vehicle.T_lidar_imu)


def _role(profile: Profile, clock: Clock | None) -> Role:
    if profile.leader is not None:
        return LeaderPlanner(profile.leader, np.random.default_rng(_PLANNER_SEED))
    follower = profile.follower or FollowerSettings()
    return FollowerRole(
        follower,
        NeighbourView(profile.neighbours),
        ObstacleGrid(profile.grid),
        np.full((profile.grid.azimuths, profile.grid.elevations), np.inf),
        _pilot(follower, clock),
    )


def _pilot(follower: FollowerSettings, clock: Clock | None) -> Pilot | None:
    if follower.controller != "policy":
        return None
    # Its runtime takes a moment to import, and most vehicles fly without.
    from companion.control.policy import load_policy

    return Pilot(load_policy(follower), clock)
