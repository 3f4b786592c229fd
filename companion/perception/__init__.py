"""From sensor data to motion and surroundings."""
