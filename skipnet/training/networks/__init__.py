"""Networks in torch, as they are trained."""
