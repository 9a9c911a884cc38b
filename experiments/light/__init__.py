"""The study of what each sense is worth, light on and off: its locked design, its analysis."""
