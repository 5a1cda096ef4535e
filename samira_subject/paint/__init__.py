"""The built-in head's surface: colours, finish and bumps, painted by where on the head a texel lies."""
