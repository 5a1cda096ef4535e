"""Every kernel again in plain torch, differentiable by autograd and able to run in float64: the specification that tests hold kernels to."""
