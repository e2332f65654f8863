"""Fine alignment: dense scans voxel by voxel, sparse ones by GICP."""
