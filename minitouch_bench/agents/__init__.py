"""Learning agents: soft actor-critic, curiosity bonuses, and their training in two phases.

Nothing here imports torch, so that the command line's help can name the methods.
"""

METHODS = ("sac", "hac", "icm", "icm-touch", "disagreement", "rnd", "rnd-touch")
"""Every method; each but ``sac`` has a curiosity."""
