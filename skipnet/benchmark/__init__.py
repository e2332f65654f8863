"""Registration methods compared on the same pairs: predict once, score many times.

``datasets`` gives the pairs, ``methods`` the candidates behind one call, ``isolation`` a process
for each, ``runner`` the predictions. ``metrics`` and ``protocols`` say what is right, ``scoring``
and ``summary`` give the figures, ``report`` the pages that people read, ``events`` TensorBoard.
"""

from __future__ import annotations
