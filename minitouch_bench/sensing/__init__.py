"""What a policy observes: the grey camera and the touch vector."""
