"""Campaigns: worlds by methods by swarm sizes by trials, and the tables they come to."""
