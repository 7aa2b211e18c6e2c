"""What the command line shows: progress and words on standard error, results on standard output."""

from __future__ import annotations

import json as json_module
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from rich.console import Console as RichConsole
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from robots.errors import DuetError

ProgressCallback = Callable[[float], None]
"""Takes the share of the work that is done, 0 to 1."""


class Console:
    """Words for people and JSON for programs, kept apart.

    Attributes:
        json: Whether standard output is for one JSON object alone.
    """

    def __init__(self, *, json: bool) -> None:
        """Open both outputs."""
        self.json = json
        self._err = RichConsole(stderr=True, highlight=False)
        self._out = RichConsole(highlight=False)

    def say(self, text: str) -> None:
        """Print a line for people on standard error."""
        self._err.print(text, markup=False, soft_wrap=True)

    def error(self, error: DuetError) -> None:
        """Print the one-line reason of a failure; with ``json`` also as an object."""
        self._err.print(f"pasdedeux: {error}", markup=False, soft_wrap=True, style="red")
        if self.json:
            self.result({"error": {"type": type(error).__name__, "text": str(error)}})

    def result(self, value: object) -> None:
        """Print the one JSON object of this command, if JSON was asked for."""
        if self.json:
            sys.stdout.write(json_module.dumps(value, indent=2) + "\n")
            sys.stdout.flush()

    def show(self, text: str) -> None:
        """Print a result for people on standard output, unless that is for JSON."""
        if not self.json:
            self._out.print(text, markup=False, soft_wrap=True)

    def table(self, title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Print a table for people on standard output, unless that is for JSON.

        A cell may carry ``[green]rich markup[/]``.
        """
        if self.json:
            return
        table = Table(title=title, title_justify="left", header_style="bold")
        for index, column in enumerate(columns):
            table.add_column(column, justify="left" if index == 0 else "right")
        for row in rows:
            table.add_row(*row)
        self._out.print(table)

    @contextmanager
    def stage(self, name: str) -> Iterator[ProgressCallback]:
        """Show the progress of one stage; leaves one line ``name  done  1.2 s`` behind."""
        started = time.perf_counter()
        if not self._err.is_terminal:
            try:
                yield lambda _: None
            except BaseException:
                self.say(f"{name:<10} failed")
                raise
            self.say(f"{name:<10} done  {time.perf_counter() - started:6.1f} s")
            return
        bar = Progress(
            TextColumn("{task.description:<10}"),
            BarColumn(32),
            TextColumn("{task.percentage:>3.0f} %"),
            TimeElapsedColumn(),
            console=self._err,
        )
        with bar:
            task = bar.add_task(name, total=1.0)
            yield lambda share: bar.update(task, completed=min(max(share, 0.0), 1.0))
            bar.update(task, completed=1.0)
