"""From hypotheses to a verdict: candidate poses, their judge, fine alignment, the pipeline."""

from __future__ import annotations
