"""Runs: the plan of one, its episodes and actions, and the opened run that every view is of."""
