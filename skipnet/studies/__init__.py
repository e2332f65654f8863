"""Studies of the method: accuracy, calibration, vigilance, misses, inliers."""
