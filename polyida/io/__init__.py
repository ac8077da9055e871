"""Runs in HDF5 files: one layout, one writer (writer.py), one reader (reader.py); nothing in a file is ever executed."""
