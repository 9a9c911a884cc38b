"""What commands share: options, and how they print and show their progress."""
