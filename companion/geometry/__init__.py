"""Rotations, poses and axis conventions."""
