"""Reports of runs: tables and plots as data, and one writer per format."""
