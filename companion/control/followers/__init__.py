"""Followers: laws that turn what is perceived into a velocity, all behind one interface."""
