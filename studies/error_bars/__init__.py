"""Modules of studies/error_bars.py: scenes whose errors are estimated and measured."""
