"""From an episode's trace to its metrics, and from episodes to estimates with intervals."""
