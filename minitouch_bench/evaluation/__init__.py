"""A policy over a suite: rollouts, engines, and the files of a run."""
