"""Methods to compare, one folder each; `adapter.py` in it holds the class `Method`."""
