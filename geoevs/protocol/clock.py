"""Timing that sees what a GPU is still doing."""

import sys


def synchronise() -> None:
    """Wait for the GPU, where a method has started one, so that the clock sees its work.

    One that is only there is left alone: starting it takes time that is not the method's.
    """
    torch = sys.modules.get("torch")
    if torch is not None and torch.cuda.is_initialized():
        torch.cuda.synchronize()
