"""PyBullet behind one class, the Panda arm, and the bodies of the scenes."""
