"""Trainings from options to reports."""
