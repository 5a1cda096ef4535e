"""Measures of a picture beside another."""
