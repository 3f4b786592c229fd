"""Worlds made of primitives, their generators, and ray casting."""
