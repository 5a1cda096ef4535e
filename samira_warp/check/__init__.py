"""Checking a dataset folder before anything is trained on it."""
