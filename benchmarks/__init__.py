"""Measurements of this machine; `make bench` runs them."""
