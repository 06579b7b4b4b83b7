"""One progress bar, on terminals only."""

import math
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

Item = TypeVar("Item")
ESTIMATED_AFTER = 10  # steps


@contextmanager
def progress_bar(title: str, total: int) -> Iterator[Callable[..., None]]:
    """A bar of `total` steps on standard error; the block gets a function that advances it."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    bar = Progress(
        *columns,
        TimeRemainingColumn(),
        console=Console(stderr=True),
        disable=not sys.stderr.isatty(),
    )
    with bar:
        task = bar.add_task(title, total=total)

        def advance(description: str | None = None) -> None:
            bar.update(task, advance=1, description=description)

        yield advance


@contextmanager
def training_bar(title: str, steps: int) -> Iterator[Callable[..., None]]:
    """A bar whose block gets a function to call with every step's loss, and more to show if any.

    Where there is no terminal, one line says after a few steps how long the rest will take.
    """
    start, done, left = time.monotonic(), 0, steps
    with progress_bar(title, steps) as advance:

        def report(loss: float, more: str = "") -> None:
            nonlocal start, done, left
            left -= 1
            if math.isnan(loss):  # a step of an earlier, killed training
                start = time.monotonic()
            else:
                done += 1
            advance(f"{title}, loss {loss:.4f}{more}")
            if done == ESTIMATED_AFTER and not sys.stderr.isatty():
                minutes = (time.monotonic() - start) / done * left / 60
                print(f"{title}: {steps} steps, about {minutes:.1f} minutes left", file=sys.stderr)

        yield report


def counted(items: Iterable[Item], advance: Callable[[], None]) -> Iterator[Item]:
    """Pass items on, advancing after each is dealt with."""
    for item in items:
        yield item
        advance()
