"""Edges to hardware: Livox LiDAR and PX4 autopilot."""
