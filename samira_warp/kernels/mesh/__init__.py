"""Triangle meshes: what meets in them, frames of faces, what is bound to them, UV layouts, and pictures."""
