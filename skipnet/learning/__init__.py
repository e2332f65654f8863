"""The network that classifies feature voxels, and everything that trains it."""
