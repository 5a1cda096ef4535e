"""Every kernel again in plain torch, differentiable and in any dtype: what tests hold the kernels to."""
