"""Models of the sensors: scan pattern and ranging of the Mid-360, and its inertial chip."""
