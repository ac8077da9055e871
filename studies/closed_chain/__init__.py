"""Modules of studies/closed_chain.py: the chain and its solvers."""
