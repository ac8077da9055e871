"""The kinds of study: a function and its Result each."""
