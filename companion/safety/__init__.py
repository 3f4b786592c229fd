"""Limits, checks and the supervisor: the last word on every setpoint."""
