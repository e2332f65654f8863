"""Networks as they are used: read patches, describe, classify."""
