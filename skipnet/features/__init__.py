"""What single voxels show: patches, primitives, descriptors."""
