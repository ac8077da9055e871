"""Sweeps: a function of one's own over many cases, here, in processes or on a cluster."""
