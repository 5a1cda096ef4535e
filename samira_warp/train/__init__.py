"""Training: from a tracked sequence to an avatar."""
