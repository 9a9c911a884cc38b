"""Proof that a run's numbers are what its episodes gave, and that this machine repeats them."""
