"""What studies/bdf_order.py is made of: runs of bounded order."""
