"""The head in a film: its pose, jaw, eyes, expression and shape, from landmarks and then from pixels."""
