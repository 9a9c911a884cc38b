"""The four tasks as Gymnasium environments."""
