"""Where the pairs come from: simulated families, folders of real scans, public data sets.

A pair set knows its names at once and makes or reads its pairs one at a time, so that a resumed run
loads only what is missing. The truth is inside each ``Pair``; only the scorer looks at it.

A new data set is a module here (a ``Layout`` for a folder, otherwise a ``Dataset``), or one of
yours, and a file of configs/dataset that names it.
"""
