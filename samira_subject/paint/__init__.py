"""The surface of the built-in head: colours, finish and bumps, painted in its atlas by where on the head a
texel lies.
"""
