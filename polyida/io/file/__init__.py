"""The result file itself: what it looks like, written, locked, read through."""
