"""Many vehicles in one world: what both fidelities of a swarm have in common."""
