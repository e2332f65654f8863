"""What many scans agree on: which pairs, which links, where each scan stands."""
