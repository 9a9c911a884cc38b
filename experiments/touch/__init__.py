"""The study of what touch is worth: its locked design, and its analysis."""
