"""Learning to follow: the swarm as a vector environment, rewards, imitation, PPO, evaluation and export."""
