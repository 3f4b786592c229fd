"""What everybody may know of everybody at the end of a step: the truth, for light and for the referee.

One row a vehicle. It never reaches anything that flies, except as the shapes that its LiDAR sees.
"""

from dataclasses import dataclass

from companion.messages import FlightState, FloatArray

P = slice(0, 3)
V = slice(3, 6)
Q = slice(6, 10)
TURN = 10
COLLISIONS = 11
STATE = 12
READY = 13
LEADER_SEEN_S = 14
MISSION_OVER = 15
WIDTH = 16

NEVER_S = -1.0
STATES = tuple(FlightState)
STATE_NUMBERS = {state: float(number) for number, state in enumerate(STATES)}


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """All vehicles at the end of one step; number 0 is the leader.

    Attributes:
        rows: (n, WIDTH); the properties name its columns.
    """

    rows: FloatArray

    @property
    def p_world(self) -> FloatArray:
        """True positions (n, 3), m."""
        return self.rows[:, P]

    @property
    def v_world(self) -> FloatArray:
        """True velocities (n, 3), m/s."""
        return self.rows[:, V]

    @property
    def q_world_body(self) -> FloatArray:
        """True attitudes (n, 4)."""
        return self.rows[:, Q]

    @property
    def turns(self) -> FloatArray:
        """Angles of the rotors (n,), rad."""
        return self.rows[:, TURN]

    @property
    def collisions(self) -> FloatArray:
        """Contacts with fixed obstacles so far (n,)."""
        return self.rows[:, COLLISIONS]

    @property
    def states(self) -> list[FlightState]:
        """The companions' states after the step before."""
        return [STATES[int(number)] for number in self.rows[:, STATE]]

    @property
    def ready(self) -> bool:
        """Everybody hovers and waits for the start."""
        return bool((self.rows[:, READY] > 0.0).all())

    @property
    def leader_seen_s(self) -> float:
        """Host time of the newest scan in which a follower knew where the leader is; NEVER_S before any."""
        return float(self.rows[1:, LEADER_SEEN_S].max())

    @property
    def mission_over(self) -> bool:
        """The leader's pause at its goal has ended, by its own account."""
        return bool(self.rows[0, MISSION_OVER] > 0.0)
