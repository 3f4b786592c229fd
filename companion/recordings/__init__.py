"""Recordings made by others, read as the sensor events that fly."""
