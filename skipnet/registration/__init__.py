"""From hypotheses to a verdict: candidate poses, their judge, fine alignment, the pipeline."""
