"""The application, its groups, and how commands print and show their progress."""
