"""How far the map itself may be off: what it inherits from the start, scan by scan."""

import numpy as np
from numpy.typing import NDArray

from companion.messages import FloatArray
from companion.perception.odometry.body_motion import cross_matrix
from companion.perception.odometry.degeneracy import Observability
from companion.perception.odometry.update import Correction

MOST_PERIODS = 32
_NEW_SHARE = 0.1  # of a scan's weight on the newest period's ground, at which the next one begins
_QUIET = 0.42  # of the assumed variance of residuals: below, errors of the map do not shrink with it
_SETTLING = 0.1
_SEEN_SHARE = 0.01  # of a scan's weight, below which a period counts as out of sight


class Anchor:
    """Uncertainty of the map and of the pose in it against the true start.

    A filter that matches scans against its map takes the map for the truth: its covariance says how well
    a scan fits, not how well the fitted ground is known. Here the ground is divided into periods by when
    it was first seen. What lies in one period shares one unknown twist (rho, phi) of the map, which
    displaces a place x by rho + phi cross x. The twists of the present pose and of all periods have one
    joint covariance, of which this class keeps account:

    - the first period is the start itself and certain;
    - a matched scan takes over the twists of the ground it matched, each by its share of the scan's
      information as far as the filter's gain lets it act;
    - a period begins with the twist of the pose that saw it first, plus how badly that pose was matched.

    So ground seen from the start stays as certain as the start, every new stretch adds one more matching
    error, and coming back takes the sum away again. Source: the covariance recursion of S. Schmidt's
    consider filter ("Application of state-space methods to navigation problems", 1966), with the periods'
    twists as considered parameters.
    """

    def __init__(self, residual_correlation: float) -> None:
        """Start at the origin.

        Args:
            residual_correlation: see `OdometrySettings`.
        """
        self._residual_correlation = residual_correlation
        self.correlation = residual_correlation * _QUIET
        """Factor on the variance of a matched pose: more where residuals scatter more."""
        size = 6 * (MOST_PERIODS + 1)
        self._joint = np.zeros((size, size))  # the pose, then the periods
        self.covariance = np.zeros((6, 6))  # of the twist that the present pose inherited
        self._starts = np.zeros(MOST_PERIODS, dtype=np.int64)
        self._seen = np.zeros(MOST_PERIODS, dtype=np.int64)
        self._scans = 0
        self.periods = 1
        self.information = np.zeros((MOST_PERIODS, 6, 6))
        self.weights = np.zeros(MOST_PERIODS)

    def restart(self) -> None:
        """Forget everything: the present pose is the origin and certain."""
        self._joint.fill(0.0)
        self.covariance.fill(0.0)
        self._starts.fill(0)
        self._seen.fill(0)
        self._scans = 0
        self.periods = 1
        self.correlation = self._residual_correlation * _QUIET

    @property
    def starts(self) -> NDArray[np.int64]:
        """First birth of each period (`periods` are valid), ascending."""
        return self._starts

    def follow(self, correction: Correction, next_birth: int) -> None:
        """Take over what a matched scan inherits from the ground it matched.

        `information` and `weights` hold the scan's share on each period. The variance of gravity in the
        map grows by what the variance of the map's tilt grew.

        Args:
            correction: an accepted correction.
            next_birth: birth of the ground that this scan will add.
        """
        state = correction.state
        self._scans += 1
        scatter = self._residual_correlation * max(_QUIET, correction.normalised_rms**2)
        self.correlation += _SETTLING * (scatter - self.correlation)
        count, twist = self.periods, twist_of_pose(correction.seen)
        gain = twist @ correction.gain
        kept = observed_part(correction.observability)
        back = kept.T @ np.linalg.inv(twist)
        mixing = np.zeros((6, 6 * (count + 1)))
        mixing[:, :6] = np.eye(6)
        shares = self.weights[:count] / max(float(self.weights[:count].sum()), 1e-12)
        for index in np.flatnonzero(shares > 0.0):
            taken = gain @ kept @ self.information[index] @ back
            mixing[:, :6] -= taken
            mixing[:, 6 * (index + 1) : 6 * (index + 2)] = taken
        used = self._joint[: mixing.shape[1], : mixing.shape[1]]
        row = mixing @ used
        own = row @ mixing.T
        used[:6, :], used[:, :6] = row, row.T
        tilt = self.covariance.diagonal()[3:5].copy()
        used[:6, :6] = self.covariance[:] = 0.5 * (own + own.T)
        # Gravity is felt in the ground at hand: as that turns against the start, the filter must follow.
        turned = np.maximum(self.covariance.diagonal()[3:5] - tilt, 0.0) * float(state.g_map @ state.g_map)
        state.covariance[[15, 16], [15, 16]] += turned[::-1]
        self._seen[np.flatnonzero(shares > _SEEN_SHARE)] = self._scans
        if shares[count - 1] > _NEW_SHARE:
            self._begin(next_birth, self.correlation * gain @ twist.T)

    def _begin(self, birth: int, matching: FloatArray) -> None:
        """Begin a period with the present pose's twist and its matching error.

        When there are too many, the ground out of sight for longest joins the period before it.
        """
        if self.periods == MOST_PERIODS:
            self._join(1 + int(np.argmin(self._seen[1 : self.periods - 1])))
        end = 6 * (self.periods + 1)
        new = slice(end, end + 6)
        self._joint[new, :end] = self._joint[:6, :end]
        self._joint[:end, new] = self._joint[:end, :6]
        self._joint[new, new] = self._joint[:6, :6] + matching
        self._starts[self.periods] = birth
        self._seen[self.periods] = self._scans
        self.periods += 1

    def _join(self, index: int) -> None:
        """Let a period's ground count as the one before it, which is older and more certain or as far."""
        first, end = 6 * (index + 1), 6 * (self.periods + 1)
        self._joint[first : end - 6, :end] = self._joint[first + 6 : end, :end].copy()
        self._joint[:end, first : end - 6] = self._joint[:end, first + 6 : end].copy()
        for column in (self._starts, self._seen):
            column[index : self.periods - 1] = column[index + 1 : self.periods].copy()
        self.periods -= 1


def twist_of_pose(pose: FloatArray) -> FloatArray:
    """Return the matrix (6, 6) that turns errors (p, theta) of a pose into a twist of the map.

    Args:
        pose: (>= 12,) p_map, then R_map_imu by rows.
    """
    twist, R_map_imu = np.eye(6), pose[3:12].reshape(3, 3)
    twist[3:, 3:] = R_map_imu
    twist[:3, 3:] = cross_matrix(pose[:3]) @ R_map_imu
    return twist


def observed_part(observability: Observability | None) -> FloatArray:
    """Return the matrix (6, 6) that removes from a gradient by (p, theta) what was not observed."""
    if observability is None or observability.kept.all():
        return np.eye(6)
    directions = observability.directions[:, observability.kept]
    scale = np.array([1.0] * 3 + [1.0 / observability.lever_m] * 3)
    return np.asarray((directions @ directions.T) * scale / scale[:, None])
