"""The third sealed generator: machines of every scale, real sampling patterns, noise taken from real recordings."""
