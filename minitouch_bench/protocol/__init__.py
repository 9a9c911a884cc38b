"""The standard protocol: suites, seeds, and its digest."""
