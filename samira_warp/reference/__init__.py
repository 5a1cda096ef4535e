"""Every kernel again in plain torch, differentiable and float64-capable: the specification that tests hold
the kernels to.
"""
