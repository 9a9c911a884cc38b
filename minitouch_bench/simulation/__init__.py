"""PyBullet behind one class, the Panda arm, the bodies of the scenes, and what is sensed."""
