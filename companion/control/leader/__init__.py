"""The leader: waypoints, RRT local path, potential field along it."""
