"""The standard protocol: suites, seeds, rollouts, engines, and the files of a run."""
