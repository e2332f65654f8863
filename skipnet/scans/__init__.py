"""What one scan knows: Skip-maps, features, evidence, where it was taken from."""
