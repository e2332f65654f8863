"""Situations that are hard to be honest about, because a wrong pose fits well."""
