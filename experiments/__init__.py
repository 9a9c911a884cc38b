"""Experiments with several trainings, as scripts on the public API; outside the package."""
