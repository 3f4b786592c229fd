"""The emulated autopilot's parameters: PX4's names, types and default values."""

from collections.abc import Mapping

_DEFAULTS: dict[str, int | float] = {
    "BAT_CRIT_THR": 0.07,
    "BAT_EMERGEN_THR": 0.05,
    "BAT_LOW_THR": 0.15,
    "COM_DISARM_LAND": 2.0,
    "COM_DISARM_PRFLT": 10.0,
    "COM_DL_LOSS_T": 10,
    "COM_FAIL_ACT_T": 5.0,
    "COM_LOW_BAT_ACT": 0,
    "COM_OBL_RC_ACT": 0,
    "COM_OF_LOSS_T": 1.0,
    "COM_POS_FS_EPH": 5.0,
    "COM_RCL_EXCEPT": 0,
    "COM_RC_IN_MODE": 3,
    "COM_RC_LOSS_T": 0.5,
    "COM_SPOOLUP_TIME": 1.0,
    "EKF2_BARO_NOISE": 3.5,
    "EKF2_EVA_NOISE": 0.1,
    "EKF2_EVP_GATE": 5.0,
    "EKF2_EVP_NOISE": 0.1,
    "EKF2_EVV_GATE": 3.0,
    "EKF2_EVV_NOISE": 0.1,
    "EKF2_EV_CTRL": 0,
    "EKF2_EV_DELAY": 0.0,
    "EKF2_EV_NOISE_MD": 0,
    "EKF2_EV_POS_X": 0.0,
    "EKF2_EV_POS_Y": 0.0,
    "EKF2_EV_POS_Z": 0.0,
    "EKF2_EV_QMIN": 0,
    "EKF2_GPS_CTRL": 7,
    "EKF2_HDG_GATE": 2.6,
    "EKF2_HGT_REF": 1,
    "EKF2_MAG_TYPE": 0,
    "EKF2_NOAID_TOUT": 5_000_000,
    "GF_ACTION": 2,
    "GF_MAX_HOR_DIST": 0.0,
    "GF_MAX_VER_DIST": 0.0,
    "MAN_OVERRIDE_SPD": 1.0,
    "MAV_FWDEXTSP": 1,
    "MAV_SYS_ID": 1,
    "MC_YAW_P": 2.8,
    "MIS_TAKEOFF_ALT": 2.5,
    "MPC_ACC_HOR": 3.0,
    "MPC_LAND_SPEED": 0.7,
    "MPC_MAN_TILT_MAX": 35.0,
    "MPC_MAN_Y_MAX": 150.0,
    "MPC_TKO_RAMP_T": 3.0,
    "MPC_TKO_SPEED": 1.5,
    "MPC_VEL_MANUAL": 10.0,
    "MPC_XY_CRUISE": 5.0,
    "MPC_XY_P": 0.95,
    "MPC_XY_VEL_MAX": 12.0,
    "MPC_YAWRAUTO_MAX": 45.0,
    "MPC_Z_P": 1.0,
    "MPC_Z_VEL_MAX_DN": 1.5,
    "MPC_Z_VEL_MAX_UP": 3.0,
    "NAV_DLL_ACT": 0,
    "NAV_MC_ALT_RAD": 0.8,
    "NAV_RCL_ACT": 2,
    "RTL_DESCEND_ALT": 10.0,
    "RTL_MIN_DIST": 10.0,
    "RTL_RETURN_ALT": 30.0,
    "SYS_AUTOSTART": 10_040,
    "SYS_FAILURE_EN": 0,
    "SYS_HAS_GPS": 1,
    "SYS_HAS_MAG": 1,
}

GNSS_DENIED: Mapping[str, int | float] = {
    "COM_OBL_RC_ACT": 4,
    "EKF2_EV_CTRL": 15,
    "EKF2_GPS_CTRL": 0,
    "EKF2_HGT_REF": 3,
    "SYS_HAS_GPS": 0,
}
"""The values that flew on external vision without GNSS; everything else at its default."""

_INT32_LIMIT = 2**31


class Parameters:
    """Parameter values by name; integers stay integers and floats stay floats, as on the autopilot."""

    def __init__(self, overrides: Mapping[str, int | float] | None = None) -> None:
        """Start from PX4's defaults with some values replaced.

        Args:
            overrides: values by parameter name.

        Raises:
            KeyError: for a parameter that does not exist.
            ValueError: for a value that the parameter's type cannot hold.
        """
        self._values = dict(_DEFAULTS)
        self._names = sorted(_DEFAULTS)
        for name, value in (overrides or {}).items():
            if name not in self._values:
                raise KeyError(name)
            if not self.set(name, value):
                raise ValueError(f"{name} cannot be {value!r}")

    def __getitem__(self, name: str) -> int | float:
        """Return a value by name.

        Raises:
            KeyError: if there is no such parameter.
        """
        return self._values[name]

    def __contains__(self, name: object) -> bool:
        return name in self._values

    def __len__(self) -> int:
        return len(self._names)

    def names(self) -> tuple[str, ...]:
        """Return all names in the order of their indices."""
        return tuple(self._names)

    def index_of(self, name: str) -> int:
        """Return the index of an existing parameter."""
        return self._names.index(name)

    def is_integer(self, name: str) -> bool:
        """Return whether an existing parameter holds an integer."""
        return isinstance(_DEFAULTS[name], int)

    def set(self, name: str, value: int | float) -> bool:
        """Change a value.

        Returns:
            False (and nothing changed) for an unknown name or a value of the wrong kind.
        """
        if name not in self._values or isinstance(value, bool):
            return False
        if self.is_integer(name):
            if not isinstance(value, int) or not -_INT32_LIMIT <= value < _INT32_LIMIT:
                return False
            self._values[name] = value
            return True
        if not abs(value) < 3.0e38:
            return False
        self._values[name] = float(value)
        return True
