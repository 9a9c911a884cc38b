"""Learning agents: soft actor-critic, curiosity bonuses, and their training in two phases."""
