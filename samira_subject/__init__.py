"""The subject that is built in: a head of our own, pictures of it, and the dataset they make."""
