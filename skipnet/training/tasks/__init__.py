"""The two tasks: classes and descriptors."""
