"""What a policy observes: the gray camera and the touch vector."""
