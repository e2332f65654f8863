"""Files of points: one file per format, one reader for all."""
