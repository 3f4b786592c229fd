"""One trial of the abstract swarm, from a scene to its record."""

from companion.control.followers.settings import FollowerSettings
from companion.control.leader.settings import LeaderSettings
from companion.logs.metrics import DEFAULT_CAP_M
from sitl.abstract.course import Course
from sitl.abstract.policy_flight import POLICY, Policy, PolicyStep
from sitl.abstract.settings import AbstractSettings
from sitl.abstract.trial import AbstractFlight, AbstractTrial, SwarmTrajectory
from sitl.swarm.scene import SwarmScene
from sitl.swarm.settings import TerminationSettings

__all__ = ["AbstractFlight", "SwarmTrajectory", "fly_abstract"]


def fly_abstract(
    scene: SwarmScene,
    method: str,
    follower: FollowerSettings,
    settings: AbstractSettings,
    *,
    termination: TerminationSettings | None = None,
    cap_m: float = DEFAULT_CAP_M,
    record: bool = False,
    world_name: str = "",
    trial: int = 0,
    leader: LeaderSettings | None = None,
    course: Course | None = None,
    policy: Policy | None = None,
) -> AbstractFlight:
    """Fly one trial; equal arguments give equal bytes, whatever else runs.

    Args:
        scene: the world, the start and the leader's way.
        method: the followers' law; `policy` for a learned policy beside the configured law.
        follower: its gains.
        settings: of perception and flight.
        termination: what ends the trial.
        cap_m: obstacles farther than this do not count for MDO.
        record: whether to keep the trajectory.
        world_name: for the record.
        trial: number of the trial, for the record.
        leader: how the leader keeps away from obstacles; mission and speed are the scene's.
        course: the leader's route if it is known already, from an earlier flight in the same scene.
        policy: the learned policy; needed with the method `policy` only.

    Raises:
        KeyError: if there is no such law.
        ValueError: if the method is `policy` and there is none.
    """
    flight = AbstractTrial(
        scene, follower.method if method == POLICY else method, follower, settings, termination=termination,
        cap_m=cap_m, record=record, leader=leader, course=course,
    )  # fmt: skip
    if method != POLICY:
        flight.fly()
    elif policy is None:
        raise ValueError("the method `policy` needs a policy")
    else:
        step = PolicyStep(policy.contract, [flight])
        while not flight.is_over:
            step.begin()
            step.finish(policy.velocities(step.observation))
    return flight.result(method, world_name, trial)
