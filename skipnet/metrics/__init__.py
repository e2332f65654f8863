"""What is measured, defined once: poses, correspondences, classes, calibration."""
