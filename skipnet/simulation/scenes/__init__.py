"""Simulated scenes: rooms, furniture, facades, kitchens, organic shapes."""
