"""Roles: what the vehicle should do next."""
