"""Registration methods compared on the same pairs: predict once, score many times.

``datasets`` gives the pairs, ``methods`` the candidates behind one call, ``runner`` the
predictions, ``metrics`` and ``scoring`` the figures, ``report`` the pages that people read.
"""
