"""Submissions: packed, checked without trust, ranked, and shown as a site."""
