"""Threads, process pools and executors."""
