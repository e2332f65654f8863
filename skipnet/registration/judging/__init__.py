"""One judge for all candidates, whoever proposed them."""
