"""Candidate poses from corners, edges, planes and correspondences."""
