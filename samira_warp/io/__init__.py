"""Files in and out: pictures, folders, JSON, tensors, and pickles that run nothing."""
