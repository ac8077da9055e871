"""Runs in HDF5 files: one layout (layout.py), one writer (writer.py), one reader (reader.py); nothing in a file is ever executed."""
