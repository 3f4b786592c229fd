"""The swarm as its decisions see it: no packets, perception by model, thousands of trials."""
