"""Which parts fly, decided by the profile."""

import numpy as np

from companion.config import Profile
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


def assemble(profile: Profile) -> Pipeline:
    """Build the pipeline of one vehicle."""
    return Pipeline(
        estimator=_estimator(profile),
        tracker=NeighbourTracker(profile.tracking, profile.vehicle.T_body_lidar),
        role=_role(profile),
        safety=profile.safety,
        authorisation_sources=profile.authorisation.sources,
    )


def _estimator(profile: Profile) -> Estimator:
    vehicle = profile.vehicle
    if profile.odometry.source == "external":
        return ExternalMotionEstimator(profile.odometry, vehicle.T_body_lidar, vehicle.T_lidar_imu)
    return LidarInertialOdometry(profile.odometry, vehicle.T_body_lidar, vehicle.T_lidar_imu)


def _role(profile: Profile) -> Role:
    if profile.leader is not None:
        return LeaderPlanner(profile.leader, np.random.default_rng(_PLANNER_SEED))
    return FollowerRole(
        profile.follower or FollowerSettings(),
        NeighbourView(profile.neighbours),
        ObstacleGrid(profile.grid),
        np.full((profile.grid.azimuths, profile.grid.elevations), np.inf),
    )
