"""The geometry of the built-in head: sections, landmarks, organs, expressions, identities."""
