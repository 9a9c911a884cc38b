"""Paired comparison of runs, and the gate that stops a change for the worse.

Everything here starts from runs as they are saved; no simulator and no policy is needed.
"""
