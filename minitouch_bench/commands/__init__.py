"""The commands, one per file: options and the order of calls; ``app`` joins them."""
