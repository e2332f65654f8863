"""What the classifier learns from, the network, and how it is trained and judged."""

from __future__ import annotations
