"""Methods at work: each in a process of its own, or timed in turns."""
