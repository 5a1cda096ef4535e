"""Triangle meshes: frames of faces, what is bound to them, and their UV layout."""
