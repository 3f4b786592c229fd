"""What the simulated vehicle really does, between the dynamics and the emulated sensors and autopilot."""

from dataclasses import dataclass

from companion.messages import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class VehicleTruth:
    """True motion of one vehicle at one instant.

    Attributes:
        t_ns: simulation time.
        p_world, v_world, accel_world: body origin's position, velocity and kinematic acceleration
            (gravity not included) in the z-up world frame, each (3,), metres and seconds.
        q_world_body: attitude of the forward-left-up body, (4,) unit quaternion (w, x, y, z).
        omega_body: angular rate, (3,) rad/s.
        on_ground: the landing gear touches the ground.
    """

    t_ns: int
    p_world: FloatArray
    v_world: FloatArray
    q_world_body: FloatArray
    omega_body: FloatArray
    accel_world: FloatArray
    on_ground: bool
