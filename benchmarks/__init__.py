"""Speed of our kernels against what a user would write instead."""
