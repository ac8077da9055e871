"""Runs in HDF5 files: layout.py describes a file, writer.py writes it, reader.py reads it. Nothing in a file is executed."""
