"""From predictions to figures: what is right, by which rule, and sums over pairs."""
