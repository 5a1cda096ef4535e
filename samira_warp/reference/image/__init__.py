"""Measures of a picture beside another, in plain torch."""
