"""Policies under evaluation: what they see and give, their formats, their own process."""
