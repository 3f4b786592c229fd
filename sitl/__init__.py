"""Everything that never flies: worlds, emulators, scenarios."""
