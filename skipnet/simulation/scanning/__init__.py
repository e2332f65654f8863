"""Scans of simulated scenes: scanners, cameras, pairs, and how scans get worse."""
