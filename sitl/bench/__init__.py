"""Measurements that a user can repeat: `sitl bench`."""
