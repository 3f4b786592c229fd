"""Other UAVs around this one, from registered scans alone: filter, cluster, track, validate."""
