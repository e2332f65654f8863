"""Training samples from simulated scenes: labelled voxels and pairs of scans."""
