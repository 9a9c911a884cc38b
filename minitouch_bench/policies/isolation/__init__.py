"""What holds a stranger's policy: one file a mechanism of the kernel."""
