"""Learning agents: their networks and their training."""
