"""Shapes: made, proven sound, packed, read back. ``manifest`` reads a set and needs numpy only."""
