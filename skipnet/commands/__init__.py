"""The commands: options, overrides, errors, and one function for each door."""
